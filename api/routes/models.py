"""Models: fitted and uploaded ones, their verbs, and the families there are."""

from __future__ import annotations

import time
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Query, Request, Response

import fitter
from api import documents, schemas
from api.access import Here, Mine
from api.exchange import (
    Body,
    FloatArray,
    checked_draws,
    read_incidences,
    read_pairs,
    respond,
    respond_samples,
)
from api.exports import ChosenChannels, export_responses, in_turn, media_type, respond_export
from api.openapi import array_request, array_response
from api.routes import Limit, Offset, page, problems
from api.rows import ModelRow
from fitter.errors import SpecError
from fitter.export import subject, targets
from fitter.models.describe import default, describe
from fitter.spec import OPTIONS, ModelSpec, model_spec

router = APIRouter(tags=["models"])

#: Pairs are padded to the next power of two, so that a handful of compiled programs serve all requests.
SMALLEST_BUCKET = 64
#: Bytes whose multiples JAX's arrays begin at.
ALIGNMENT = 64


@router.get("/v1/models", response_model=schemas.Page[schemas.ModelDocument], responses=problems(422))
def models(
    request: Request, response: Response, here: Here, limit: Limit = 50, offset: Offset = 0
) -> dict[str, Any]:
    """Fitted and uploaded models, newest first."""
    rows, total = here.page(ModelRow, limit, offset)
    return page(request, response, [documents.model(row) for row in rows], total, limit, offset)


@router.post(
    "/v1/models", status_code=201, response_model=schemas.ModelDocument, responses=problems(400, 413, 422)
)
def upload(wanted: schemas.ModelRequest, here: Here, response: Response) -> dict[str, Any]:
    """Keep a model whose parameters were made elsewhere."""
    spec = model_spec(wanted.model)
    known = [p.name for p in fitter.models.parameter_table(spec)]
    for name in wanted.values:
        if name not in known:
            raise SpecError(
                f"{spec.name} has no parameter {name[:64]!r}", code="unknown-parameter", parameter=name[:64],
                remedy=f"its parameters are {', '.join(known)}",
            )  # fmt: skip
    if wanted.channels is not None and len(set(wanted.channels)) < len(wanted.channels):
        raise SpecError(
            "two channels have the same name", code="bad-channels", parameter="channels",
            remedy="give one distinct name per channel",
        )  # fmt: skip
    values = {name: np.asarray(value) for name, value in wanted.values.items()}
    model = fitter.models.create(spec, channels=wanted.channels, **values)
    row = here.made_before(ModelRow)
    if row is None:
        row = ModelRow(
            id=here.new_id(), created=time.time(), owner=here.caller.owner, origin="upload", name=spec.name,
            document=model.to_dict(),
        )  # fmt: skip
        here.service.store.add(row)
    response.headers["Location"] = f"/v1/models/{row.id}"
    return documents.model(row)


@router.get("/v1/models/{id}", response_model=schemas.ModelDocument, responses=problems(404, 422))
def model(id: str, here: Here) -> dict[str, Any]:
    """A model. The id of a fit names the model it found."""
    return documents.model(here.get(ModelRow, id))


@router.post(
    "/v1/models/{id}/evaluate",
    responses={**problems(400, 404, 413, 422), **array_response(schemas.EvaluationDocument)},
    openapi_extra=array_request("wi", "wo"),
)  # fmt: skip
def evaluate(id: str, request: Request, body: Body, here: Here) -> Response:
    """f without the cosine, 1/sr, at direction pairs; 0 where wo is below the horizon, unless the model
    transmits. Ideal (delta) components are not part of it."""
    found = _model(here, id)
    wi, wo = read_pairs(request, body, here.service.settings.max_pairs)
    values = np.asarray(found.evaluate(*_padded(wi, wo)))[: len(wi)]
    document = {"channels": list(found.channels), "unit": "1/sr", "values": values}
    return respond(request, document, values)


@router.post(
    "/v1/models/{id}/pdf",
    responses={**problems(400, 404, 413, 422), **array_response(schemas.PdfDocument)},
    openapi_extra=array_request("wi", "wo"),
)  # fmt: skip
def pdf(id: str, request: Request, body: Body, here: Here) -> Response:
    """Density of `sample` drawing wo given wi, per unit solid angle."""
    found = _model(here, id)
    wi, wo = read_pairs(request, body, here.service.settings.max_pairs)
    values = np.asarray(found.pdf(*_padded(wi, wo)))[: len(wi)]
    return respond(request, {"unit": "1/sr", "values": values}, values)


@router.post(
    "/v1/models/{id}/albedo",
    responses={**problems(400, 404, 413, 422), **array_response(schemas.AlbedoDocument)},
    openapi_extra=array_request("wi"),
)  # fmt: skip
def albedo(id: str, request: Request, body: Body, here: Here) -> Response:
    """Directional-hemispherical reflectance, and transmittance where the model has one."""
    found = _model(here, id)
    wi = read_incidences(request, body, here.service.settings.max_albedo_directions)
    values = np.asarray(found.albedo(wi))
    through = np.asarray(found.transmittance(wi)) if found.transmits(found.spec) else None
    document = {"channels": list(found.channels), "values": values, "transmittance": through}
    return respond(request, document, values)


@router.post(
    "/v1/models/{id}/sample",
    responses={**problems(400, 404, 413, 422), **array_response(schemas.SamplesDocument)},
)
def sample(id: str, request: Request, wanted: schemas.SampleRequest, here: Here) -> Response:
    """Directions drawn for one incidence, with their densities and weights."""
    found = _model(here, id)
    wi = checked_draws(wanted.wi, wanted.n, here.service.settings.max_draws)
    return respond_samples(request, found.sample(wi, wanted.n, seed=wanted.seed), found.channels)


@router.get(
    "/v1/models/{id}/export/{format}", response_class=Response,
    responses={**export_responses(tables=False), **problems(404, 422)},
)  # fmt: skip
async def export(
    id: str, format: str, here: Here, channels: ChosenChannels = None,
    unconverged: Annotated[bool, Query(description="also a fit that did not converge")] = False,
) -> Response:  # fmt: skip
    """The model as a file of another program; `/v1/export-targets` lists the formats."""

    def made() -> Response:
        row = here.get(ModelRow, id)
        if row.origin == "fit":
            from fitter.fitting import FitResult  # takes a second, and only here

            found = subject(FitResult.from_dict(here.service.results.read(row.id)))
        else:
            found = subject(fitter.models.from_dict(row.document), name=row.name)
        return respond_export(found, format, channels=channels, unconverged=unconverged)

    return await in_turn(here, format, made)


def _targets() -> list[dict[str, Any]]:
    return [
        {"name": entry.name, "description": entry.description, "models": entry.models, "tables": entry.tables,
         "convention": entry.convention, "media_type": media_type(entry.name)}
        for entry in targets()
    ]  # fmt: skip


def _family(spec: ModelSpec) -> dict[str, Any]:
    described = describe(spec)
    properties: dict[str, Any] = {}
    for p in described["parameters"]:
        number = {"type": "number", "minimum": p["lower"]}
        if p["upper"] is not None:
            number["maximum"] = p["upper"]
        properties[p["name"]] = {
            "oneOf": [number, {"type": "array", "items": number, "minItems": 1}],
            "default": p["default"], "description": f"{p['description']}, unit {p['unit']}",
        }  # fmt: skip
    schema = {"type": "object", "properties": properties, "additionalProperties": False}
    return {**described, "values_schema": schema}


EXAMPLES = {"/v1/export-targets": _targets()[:1], "/v1/model-families": [_family(default("lambert"))]}


@router.get("/v1/export-targets", response_model=list[schemas.ExportTargetDocument])
def export_targets() -> list[dict[str, Any]]:
    """What models and tables can be exported to."""
    return _targets()


@router.get("/v1/model-families", response_model=list[schemas.FamilyDocument])
def families() -> list[dict[str, Any]]:
    """Every model there is, each with its options and the parameters of its default form; first those that
    are fitted."""
    return [_family(default(name)) for name in OPTIONS]


@router.get("/v1/model-families/{name}", response_model=schemas.FamilyDocument, responses=problems(422))
def family(name: str) -> dict[str, Any]:
    """The parameters of one form, by its short name, as `torrance_sparrow:ggx` or `lafortune:2`."""
    return _family(model_spec(name))


def _model(here: Mine, id: str) -> Any:
    kept = here.service.models.kept(id)
    if kept is not None and here.sees(kept[0]):
        return kept[1]
    return here.service.models.open(here.get(ModelRow, id))


def _padded(wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pairs (M, 3) with the last one repeated up to the bucket's size."""
    count = max(SMALLEST_BUCKET, 1 << (len(wi) - 1).bit_length())
    return _stretched(wi, count), _stretched(wo, count)


def _stretched(w: FloatArray, count: int) -> FloatArray:
    # Memory that begins where JAX wants it is used as it is; other it copies once more.
    room = np.empty(3 * count + ALIGNMENT // 8)
    start = -room.ctypes.data % ALIGNMENT // 8
    stretched = room[start : start + 3 * count].reshape(count, 3)
    stretched[: len(w)], stretched[len(w) :] = w, w[-1]
    return stretched
