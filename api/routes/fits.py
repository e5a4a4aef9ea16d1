"""Fits and posteriors: ask for them, list them, read them, and their reports."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Request, Response

from api import documents, exchange, schemas
from api.access import Here, Mine
from api.exports import ChosenChannels, draws_responses, in_turn, respond_draws
from api.limits import bounded_calibration, check_posterior
from api.problems import Problem
from api.reports import Kind, report
from api.routes import Limit, Offset, OfTable, page, problems
from api.rows import CalibrationRow, ModelRow, PosteriorRow, TableRow
from api.starting import Prefer, answers, started
from fitter.documents import dumps
from fitter.errors import SpecError
from fitter.fitting import check
from fitter.spec import AUTO, FitSpec, calibration_spec, fit_spec, selection_spec

MEDIA: dict[Kind, str] = {
    "pdf": "application/pdf", "html": "text/html", "json": "application/json"
}  # fmt: skip
router = APIRouter(prefix="/v1", tags=["fits"])


@router.post(
    "/fits", status_code=202, response_model=schemas.JobDocument, responses=answers(400, 404, 413, 422, 429)
)
async def start_fit(
    wanted: schemas.FitRequest, here: Here, response: Response, prefer: Prefer = None
) -> dict[str, Any]:
    """Fit one model, or several, to a table, or compare models ("auto"). The answer is a job; when done it
    links one fit a model."""
    return await started(here, response, prefer, "fit", lambda: (wanted.table, _fit_request(wanted)))


@router.post(
    "/posteriors", status_code=202, response_model=schemas.JobDocument,
    responses=answers(400, 404, 409, 413, 422, 429), tags=["posteriors"],
)  # fmt: skip
async def start_posterior(
    wanted: schemas.PosteriorRequest, here: Here, response: Response, prefer: Prefer = None
) -> dict[str, Any]:
    """Sample the posterior of a finished fit. The answer is a job."""

    def prepare() -> tuple[str, dict[str, Any]]:
        check_posterior(wanted, here.service.settings)
        row = with_table(here, fit_row(here, wanted.fit))
        spec = wanted.model_dump(mode="json", exclude={"fit"}, exclude_unset=True)
        return str(row.table_id), {"fit": row.id, "spec": spec}

    return await started(here, response, prefer, "posterior", prepare)


@router.post(
    "/calibrations", status_code=202, response_model=schemas.JobDocument,
    responses=answers(400, 404, 409, 413, 422, 429), tags=["posteriors"],
)  # fmt: skip
async def start_calibration(
    wanted: schemas.CalibrationRequest, here: Here, response: Response, prefer: Prefer = None
) -> dict[str, Any]:
    """Judge posteriors of a finished fit's model by simulations on its table's directions. The answer is a
    job; a simulation takes about a second. It ends after `time_limit_seconds`, by default as late as the
    server allows."""

    def prepare() -> tuple[str, dict[str, Any]]:
        given = wanted.model_dump(mode="json", exclude={"fit"}, exclude_unset=True)
        spec = bounded_calibration(calibration_spec(given), here.service.settings)
        row = with_table(here, fit_row(here, wanted.fit))
        return str(row.table_id), {"fit": row.id, "spec": spec.model_dump(mode="json")}

    return await started(here, response, prefer, "calibration", prepare)


@router.get("/fits", response_model=schemas.Page[schemas.FitSummary], responses=problems(422))
def fits(
    request: Request, response: Response, here: Here, limit: Limit = 50, offset: Offset = 0,
    table: OfTable = None,
) -> dict[str, Any]:  # fmt: skip
    """The finished fits, newest first."""
    of_table = () if table is None else (ModelRow.table_id == table,)
    rows, total = here.page(ModelRow, limit, offset, ModelRow.origin == "fit", *of_table)
    return page(request, response, [documents.fit(row) for row in rows], total, limit, offset)


@router.get("/fits/{id}", response_model=schemas.FitDocument, responses=problems(404, 422))
def fit(id: str, here: Here) -> Response:
    """The whole result: a file of it is what `brdf-fitter posterior`, `report` and `sample` take."""
    row = fit_row(here, id)
    made, _ = here.page(PosteriorRow, 100, 0, PosteriorRow.fit_id == id)
    document = here.service.results.read(id)
    added = {"id": id, "posteriors": [one.id for one in made], "links": documents.fit_links(row)}
    return Response(dumps({**document, **added}), media_type="application/json")


@router.get("/fits/{id}/report.json", responses=problems(404, 409, 422))
def report_json(id: str, here: Here) -> dict[str, Any]:
    """The report as a record, with the latest posterior of the fit when there is one."""
    return _report(here, id, "json")  # type: ignore[return-value]  # a Response passes through unchanged


@router.get(
    "/fits/{id}/report.html", response_class=Response,
    responses={**problems(404, 409, 422), 200: {"content": {"text/html": {"schema": {"type": "string"}}}}},
)  # fmt: skip
def report_html(id: str, here: Here) -> Response:
    """The report as one self-contained page."""
    return _report(here, id, "html")


@router.get(
    "/fits/{id}/report.pdf", response_class=Response,
    responses={
        **problems(404, 409, 422),
        200: {"content": {"application/pdf": {"schema": {"type": "string", "format": "binary"}}}},
    },
)  # fmt: skip
def report_pdf(id: str, here: Here) -> Response:
    """The report on A4 pages."""
    return _report(here, id, "pdf")


@router.get(
    "/fits/{id}/report", response_class=Response,
    responses={
        **problems(404, 409, 422),
        200: {
            "content": {
                "application/json": {"schema": {"type": "object"}},
                "text/html": {"schema": {"type": "string"}},
                "application/pdf": {"schema": {"type": "string", "format": "binary"}},
            }
        },
    },
)  # fmt: skip
def report_as_accepted(id: str, here: Here, accept: Annotated[str | None, Header()] = None) -> Response:
    """The report as what the header `Accept` names first: a PDF, a page, or else the record."""
    wanted = exchange.preferred(accept or "", MEDIA.values())
    return _report(here, id, next(kind for kind, media in MEDIA.items() if media == wanted))


@router.get(
    "/posteriors", response_model=schemas.Page[schemas.PosteriorSummary], responses=problems(422),
    tags=["posteriors"],
)  # fmt: skip
def posteriors(
    request: Request, response: Response, here: Here, limit: Limit = 50, offset: Offset = 0
) -> dict[str, Any]:
    """The sampled posteriors, newest first."""
    rows, total = here.page(PosteriorRow, limit, offset)
    return page(request, response, [documents.of_fit(row) for row in rows], total, limit, offset)


@router.get(
    "/posteriors/{id}", response_model=schemas.PosteriorDocument, responses=problems(404, 422),
    tags=["posteriors"],
)  # fmt: skip
def posterior(id: str, here: Here) -> Response:
    """The whole posterior: draws, credible intervals, diagnostics."""
    links = documents.of_fit_links(here.get(PosteriorRow, id))
    document = {**here.service.results.read(id), "id": id, "links": links}
    return Response(dumps(document), media_type="application/json")


@router.get(
    "/posteriors/{id}/export/{format}", response_class=Response,
    responses={**draws_responses(), **problems(404, 422)}, tags=["posteriors"],
)  # fmt: skip
async def posterior_export(
    id: str, format: str, here: Here,
    draws: Annotated[int, Query(ge=1, le=16, description="how many, evenly spaced through the posterior")],
    channels: ChosenChannels = None,
    unconverged: Annotated[bool, Query(description="also of a posterior that did not converge")] = False,
) -> Response:  # fmt: skip
    """Draws of the posterior as a set of materials; `/v1/export-targets` lists the formats."""

    def made() -> Response:
        here.get(PosteriorRow, id)
        from fitter.posterior import Posterior  # takes a second, and only here

        found = Posterior.from_dict(here.service.results.read(id))
        return respond_draws(found, format, draws, channels=channels, unconverged=unconverged)

    return await in_turn(here, format, made)


@router.get(
    "/calibrations", response_model=schemas.Page[schemas.CalibrationSummary], responses=problems(422),
    tags=["posteriors"],
)  # fmt: skip
def calibrations(
    request: Request, response: Response, here: Here, limit: Limit = 50, offset: Offset = 0
) -> dict[str, Any]:
    """The finished calibrations, newest first."""
    rows, total = here.page(CalibrationRow, limit, offset)
    return page(request, response, [documents.of_fit(row) for row in rows], total, limit, offset)


@router.get(
    "/calibrations/{id}", response_model=schemas.CalibrationDocument, responses=problems(404, 422),
    tags=["posteriors"],
)  # fmt: skip
def calibration(id: str, here: Here) -> Response:
    """The whole calibration: every rank, the tests, the verdict."""
    links = documents.of_fit_links(here.get(CalibrationRow, id))
    document = {**here.service.results.read(id), "id": id, "links": links}
    return Response(dumps(document), media_type="application/json")


@router.get(
    "/calibrations/{id}/picture.png", response_class=Response,
    responses={
        **problems(404, 422),
        200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}},
    },
    tags=["posteriors"],
)  # fmt: skip
def calibration_picture(id: str, here: Here) -> Response:
    """How far the ranks' distribution functions stray from uniform, with their simultaneous bands."""
    return Response(here.drawn(CalibrationRow, id, "png"), media_type="image/png")


def with_table(here: Mine, row: ModelRow) -> ModelRow:
    """The row of a fit whose table is still there. Raises Problem (409)."""
    if here.find(TableRow, row.table_id or "") is None:
        raise Problem(
            409, "table-gone", "the table of this fit was deleted", remedy="upload it again and fit again"
        )
    return row


def fit_row(here: Mine, id: str) -> ModelRow:
    """The row of a fit. Raises Problem (404)."""
    row = here.get(ModelRow, id, "fit")
    if row.origin != "fit":
        raise Problem.not_found("fit", id)
    return row


def _fit_request(wanted: schemas.FitRequest) -> dict[str, Any]:
    """What a job of these fits works from. Raises SpecError."""
    auto = {"candidates", "folds"}
    if wanted.model == AUTO and wanted.models is None:
        return {"selection": _selection(wanted)}
    if misplaced := sorted(auto & wanted.model_fields_set):
        raise SpecError(
            f"{misplaced[0]} belongs to the model \"auto\"", code="bad-spec", parameter=misplaced[0],
            remedy='give "model": "auto", or leave it out',
        )  # fmt: skip
    given = wanted.model_dump(mode="json", exclude={"table", "model", "models"} | auto, exclude_unset=True)
    chosen = wanted.models if wanted.models is not None else [wanted.model]
    if (wanted.model is None) == (wanted.models is None):
        raise SpecError(
            "exactly one of model and models is needed", code="bad-spec", parameter="model",
            remedy='give "model": "ward", or "models": ["ward", "lafortune:2"]',
        )  # fmt: skip
    specs = [
        fit_spec({**given, "model": one if isinstance(one, str) else one.model_dump()})
        for one in chosen if one is not None
    ]  # fmt: skip
    if len(specs) == 1:  # of several, those that make no sense are listed with what came of the others
        check(specs[0])
    return {"specs": [spec.model_dump(mode="json") for spec in specs]}


def _selection(wanted: schemas.FitRequest) -> dict[str, Any]:
    """The SelectionSpec of a request, JSON-ready. Raises SpecError, also for what has no place in it."""
    for name in ("fixed", "bounds"):
        if getattr(wanted, name):
            raise SpecError(
                f'{name} can\'t go with the model "auto"', code="bad-spec", parameter=name,
                cause="it names a parameter of one model", remedy="name the model",
            )  # fmt: skip
    spec = selection_spec(
        wanted.model_dump(
            mode="json", exclude={"table", "model", "models", "fixed", "bounds"}, exclude_unset=True
        )
    )
    for model in spec.candidates or ():
        check(FitSpec(model=model))
    return spec.model_dump(mode="json")


def _report(here: Mine, id: str, kind: Kind) -> Response:
    content = report(here, fit_row(here, id), kind)
    return Response(content, media_type=MEDIA[kind], headers={"Vary": "Accept"})
