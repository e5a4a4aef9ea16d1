"""Scenes: planned at once, rendered as a job, their pictures."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response

from api import documents, schemas
from api.access import Here
from api.routes import Limit, Offset, page, problems
from api.rows import SceneRow
from api.scenes import scene_of
from api.starting import Prefer, answers, started
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

    scene = scene_of(wanted.scene, here.find, here.service.tables)
    # As reports do, it takes every core there is.
    with here.service.report_lock:
        found = plan(scene, tolerance=wanted.tolerance, seed=wanted.seed)
    return Response(dumps(found.document), media_type="application/json")


@router.post(
    "/scenes/render", status_code=202, response_model=schemas.JobDocument,
    responses=answers(400, 404, 413, 422, 429),
)  # fmt: skip
async def render_scene(
    wanted: schemas.RenderRequest, here: Here, response: Response, prefer: Prefer = None
) -> dict[str, Any]:
    """Render a scene. The answer is a job; when done it links the picture, as OpenEXR and PNG.

    It stops at `samples` a pixel, `seconds` or `target_error`, whichever comes first.
    """

    def prepare() -> tuple[None, dict[str, Any]]:
        request = wanted.model_dump(mode="json")
        # What makes no sense, and what is not the caller's, is said now, not by a job that fails.
        scene_of(request["scene"], here.find, here.service.tables)
        return None, request

    return await started(here, response, prefer, "scene", prepare)


@router.get("/scenes", response_model=schemas.Page[schemas.SceneSummary], responses=problems(422))
def scenes(
    request: Request, response: Response, here: Here, limit: Limit = 50, offset: Offset = 0
) -> dict[str, Any]:
    """The rendered scenes, newest first."""
    rows, total = here.page(SceneRow, limit, offset)
    return page(request, response, [documents.scene(row) for row in rows], total, limit, offset)


@router.get("/scenes/{id}", response_model=schemas.PictureDocument, responses=problems(404, 422))
def picture(id: str, here: Here) -> Response:
    """What was rendered: samples, error against time, notes, and the plan where there was one."""
    shown = documents.scene(here.get(SceneRow, id))
    added = {"id": id, "links": shown["links"]}
    return Response(dumps({**here.service.results.read(id), **added}), media_type="application/json")


@router.get(
    "/scenes/{id}/picture.exr", response_class=Response,
    responses={
        **problems(404, 422),
        200: {"content": {"image/x-exr": {"schema": {"type": "string", "format": "binary"}}}},
    },
)  # fmt: skip
def picture_exr(id: str, here: Here) -> Response:
    """Linear radiance, W/(m2 sr), `se.<channel>` its standard error, layers where asked for."""
    return Response(here.drawn(SceneRow, id, "exr"), media_type="image/x-exr")


@router.get(
    "/scenes/{id}/picture.png", response_class=Response,
    responses={
        **problems(404, 422),
        200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}},
    },
)  # fmt: skip
def picture_png(id: str, here: Here) -> Response:
    """Tone-mapped."""
    return Response(here.drawn(SceneRow, id, "png"), media_type="image/png")
