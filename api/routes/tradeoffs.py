"""Tradeoffs: measure what accuracy costs on a table, and read what was measured."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response

from api import documents, schemas
from api.access import Here
from api.routes import Limit, Offset, page, problems
from api.rows import TradeoffRow
from api.starting import Prefer, answers, started
from fitter.documents import dumps
from fitter.fitting import check
from fitter.spec import FitSpec, tradeoff_spec

router = APIRouter(prefix="/v1", tags=["tradeoffs"])


@router.post(
    "/tradeoffs", status_code=202, response_model=schemas.JobDocument,
    responses=answers(400, 404, 413, 422, 429),
)  # fmt: skip
async def start_tradeoff(
    wanted: schemas.TradeoffRequest, here: Here, response: Response, prefer: Prefer = None
) -> dict[str, Any]:
    """Measure error against seconds and memory for models of a table. The answer is a job.

    It takes about `time_limit_seconds`, and has the machine to itself only if nothing else runs: the noise of
    the seconds is part of the result.
    """

    def prepare() -> tuple[str, dict[str, Any]]:
        spec = tradeoff_spec(wanted.model_dump(mode="json", exclude={"table"}, exclude_unset=True))
        for model in spec.models:
            check(FitSpec(model=model, metric=spec.metric, select=spec.select))
        return wanted.table, {"spec": spec.model_dump(mode="json")}

    return await started(here, response, prefer, "tradeoff", prepare)


@router.get("/tradeoffs", response_model=schemas.Page[schemas.TradeoffSummary], responses=problems(422))
def tradeoffs(
    request: Request, response: Response, here: Here, limit: Limit = 50, offset: Offset = 0
) -> dict[str, Any]:
    """The finished tradeoffs, newest first."""
    rows, total = here.page(TradeoffRow, limit, offset)
    return page(request, response, [documents.tradeoff(row) for row in rows], total, limit, offset)


@router.get("/tradeoffs/{id}", response_model=schemas.TradeoffDocument, responses=problems(404, 422))
def tradeoff(id: str, here: Here) -> Response:
    """Every point, with its seconds, memory and errors."""
    shown = documents.tradeoff(here.get(TradeoffRow, id))
    added = {"id": id, "links": shown["links"]}
    return Response(dumps({**here.service.results.read(id), **added}), media_type="application/json")


@router.get(
    "/tradeoffs/{id}/report.html", response_class=Response,
    responses={**problems(404, 422), 200: {"content": {"text/html": {"schema": {"type": "string"}}}}},
)  # fmt: skip
def report(id: str, here: Here) -> Response:
    """The picture and the numbers as one self-contained page."""
    return Response(here.drawn(TradeoffRow, id, "html"), media_type="text/html")


@router.get(
    "/tradeoffs/{id}/picture.png", response_class=Response,
    responses={
        **problems(404, 422),
        200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}},
    },
)  # fmt: skip
def picture(id: str, here: Here) -> Response:
    """Error against seconds, log-log, points labelled, the Pareto front drawn."""
    return Response(here.drawn(TradeoffRow, id, "png"), media_type="image/png")
