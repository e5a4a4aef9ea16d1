"""Scenes: planned at once, rendered as a job, their pictures."""

from __future__ import annotations

import time
from typing import Any

from fastapi import APIRouter, Response

from api import documents, schemas
from api.problems import Problem
from api.routes import Limit, Offset, problems
from api.rows import JobRow, SceneRow
from api.scenes import scene_of
from api.service import Here, Service
from api.store import new_id
from fitter.documents import dumps

router = APIRouter(prefix="/v1", tags=["scenes"])


@router.post(
    "/scenes/plan", response_model=schemas.PlanDocument, responses=problems(400, 404, 413, 422)
)  # fmt: skip
def plan_scene(wanted: schemas.PlanRequest, here: Here) -> Response:
    """Which effects of a scene can be left out within its tolerance, proved, and what that saves.

    `fit` of a material is the id of a model, `table` that of a table; files can't be named. Some seconds.
    """
    from fitter.scene import plan

    scene = scene_of(wanted.scene, here.store, here.tables)
    # As reports do, it takes every core there is.
    with here.report_lock:
        found = plan(scene, tolerance=wanted.tolerance, seed=wanted.seed)
    return Response(dumps(found.document), media_type="application/json")


@router.post(
    "/scenes/render", status_code=202, response_model=schemas.JobDocument,
    responses=problems(400, 404, 413, 422, 429),
)  # fmt: skip
def render_scene(wanted: schemas.RenderRequest, here: Here, response: Response) -> dict[str, Any]:
    """Render a scene. The answer is a job; when done it links the picture, as OpenEXR and PNG.

    It stops at `samples` a pixel, `seconds` or `target_error`, whichever comes first.
    """
    request = wanted.model_dump(mode="json")
    # What makes no sense is said now, not by a job that fails.
    scene_of(request["scene"], here.store, here.tables)
    job = JobRow(id=new_id(), created=time.time(), kind="scene", table_id="", request=request)
    here.submit(job)
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return documents.job(job)


@router.get("/scenes", response_model=schemas.Page[schemas.SceneSummary], responses=problems(422))
def scenes(here: Here, limit: Limit = 50, offset: Offset = 0) -> dict[str, Any]:
    """The rendered scenes, newest first."""
    rows, total = here.store.page(SceneRow, limit, offset)
    return documents.page([documents.scene(row) for row in rows], total, limit, offset)


@router.get("/scenes/{id}", response_model=schemas.PictureDocument, responses=problems(404, 422))
def picture(id: str, here: Here) -> Response:
    """What was rendered: samples, error against time, notes, and the plan where there was one."""
    shown = documents.scene(_row(here, id))
    added = {"id": id, "links": shown["links"]}
    return Response(dumps({**here.results.read(id), **added}), media_type="application/json")


@router.get(
    "/scenes/{id}/picture.exr", response_class=Response,
    responses={
        **problems(404, 422),
        200: {"content": {"image/x-exr": {"schema": {"type": "string", "format": "binary"}}}},
    },
)  # fmt: skip
def picture_exr(id: str, here: Here) -> Response:
    """Linear radiance, W/(m2 sr), `se.<channel>` its standard error, layers where asked for."""
    return Response(_drawn(here, id, "exr"), media_type="image/x-exr")


@router.get(
    "/scenes/{id}/picture.png", response_class=Response,
    responses={
        **problems(404, 422),
        200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}},
    },
)  # fmt: skip
def picture_png(id: str, here: Here) -> Response:
    """Tone-mapped."""
    return Response(_drawn(here, id, "png"), media_type="image/png")


def _row(here: Service, id: str) -> SceneRow:
    row = here.store.get(SceneRow, id)
    if row is None:
        raise Problem.not_found("scene", id)
    return row


def _drawn(here: Service, id: str, kind: str) -> bytes:
    content = here.results.report(_row(here, id).id, kind)
    assert content is not None  # written before the row was published
    return content
