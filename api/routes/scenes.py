"""Scenes: planned at once, rendered as a job, their pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fastapi import APIRouter, Request, Response

from api import documents, schemas
from api.access import Here, Mine
from api.problems import Problem
from api.routes import Limit, Offset, page, problems
from api.rows import SceneRow
from api.scenes import scene_of
from api.starting import Prefer, answers, started
from fitter.documents import dumps

if TYPE_CHECKING:
    from fitter.scene.comparison import Pixels

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
        asked = {name: getattr(wanted, name) for name in ("tolerance", "seed", "precision", "tiles")}
        found = plan(scene, **asked)
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


@router.get(
    "/scenes/{id}/difference/{other}", response_model=schemas.DifferenceDocument,
    responses=problems(404, 409, 422),
)  # fmt: skip
def difference(id: str, other: str, here: Here) -> dict[str, Any]:
    """How far the picture `other`, of a fit, say, is from this one, of the table: per channel, over F."""
    from fitter.scene.comparison import apart

    first, second, scale = _both(here, id, other)
    return {"numbers": apart(first, second, scale), "reference": scale}


@router.get(
    "/scenes/{id}/difference/{other}/picture.png", response_class=Response,
    responses={
        **problems(404, 409, 422),
        200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}},
    },
)  # fmt: skip
def difference_png(id: str, other: str, here: Here) -> Response:
    """Both pictures, tone-mapped alike, and `other` less this one, fourfold around grey: three side by side,
    2 pixels between."""
    from fitter.scene.comparison import beside

    return Response(beside(*_both(here, id, other)), media_type="image/png")


def _both(here: Mine, id: str, other: str) -> tuple[Pixels, Pixels, float]:
    """The pixels of two pictures, and F of the first. Raises Problem: 404, 409 where they don't match."""
    from fitter.scene.comparison import Pixels
    from fitter.scene.picture import planes_of

    found: list[Pixels] = []
    references: list[float] = []
    for one in (id, other):
        content = here.drawn(SceneRow, one, "exr")
        document = here.service.results.read(one)
        found.append(Pixels(*planes_of(content, document["channels"]), tuple(document["channels"])))
        references.append(float(document["reference"]))
    first, second = found
    if first.radiance.shape != second.radiance.shape or first.channels != second.channels:
        sizes = " and ".join(f"{one.radiance.shape[1]} x {one.radiance.shape[0]}" for one in found)
        names = " and ".join(", ".join(one.channels) for one in found)
        raise Problem(
            409, "pictures-differ", f"the pictures are {sizes} pixels, of channels {names}",
            remedy="render both with the same camera and channels",
        )  # fmt: skip
    return first, second, references[0]
