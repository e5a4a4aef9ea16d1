"""Tables: upload, list, look at, evaluate, draw from, delete."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated, Any

import numpy as np
import orjson
from anyio import to_thread
from fastapi import APIRouter, Header, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

import fitter
from api import documents, schemas
from api.access import Here, Mine
from api.blobs import Incoming
from api.contents import respond_content
from api.exchange import Body, checked_draws, limited, read_pairs, respond, respond_samples
from api.exports import ChosenChannels, export_responses, in_turn, respond_export
from api.forms import FileForm
from api.openapi import array_request, array_response, upload_request
from api.problems import Problem
from api.receiving import copy, receive
from api.routes import Limit, Offset, page, problems
from api.rows import TableRow
from api.schemas import Label
from api.store import InUse, Missing
from fitter.documents import dumps
from fitter.export import subject
from fitter.formats.describe import describe
from fitter.formats.fills import Fills
from fitter.formats.read_options import ReadOptions, read_options
from fitter.masking import Treatment
from fitter.metadata import Quantity
from fitter.quality import overview

router = APIRouter(prefix="/v1/tables", tags=["tables"])


class ReadingOptions(BaseModel):
    """What a file can't say about itself."""

    model_config = ConfigDict(extra="forbid")

    quantity: Quantity | None = Field(None, description="what the values are, where the file can't say")
    convention: str | None = Field(None, max_length=64, description="how azimuths or cells are meant")
    item: str | None = Field(None, max_length=200, description="which table, where the file holds several")
    columns: str | None = Field(
        None, max_length=100_000,
        description="delimited text: JSON object, column (name or position from 0) -> meaning, "
        'as `{"thetai": "theta_i_deg", "5": "brdf_R"}`',
    )  # fmt: skip
    negatives: Treatment = Field("mask", description="whether negative values are used")
    duplicates: Treatment = Field("mask", description="whether repeated geometries are used")
    fills: Fills = Field(
        "mask", description="fill values; `floors` masks repeated zeros and constant lowest values, too"
    )
    name: Label | None = Field(None, description="what to call it; default what the file says")


@router.post(
    "", status_code=201, response_model=schemas.TableDocument, responses=problems(400, 413, 422),
    openapi_extra=upload_request(),
)  # fmt: skip
async def upload(
    request: Request, response: Response, here: Here, reading: Annotated[ReadingOptions, Query()]
) -> dict[str, Any]:
    """Upload a measured table: the file's bytes as the body, or a form with one field `file`.

    The format is told by content. A file that can't be read is refused with the row and column, and
    nothing of it is kept.
    """
    given = {**reading.model_dump(), "columns": _columns(reading.columns)}
    options = read_options(given)
    with here.service.blobs.incoming(here.service.settings.max_upload_bytes) as incoming:
        content_type = request.headers.get("content-type", "")
        if content_type.lower().startswith("multipart/form-data"):
            form = FileForm(content_type, incoming.write)
            await receive(request, form.write)
            form.finish()
            if form.filename and not reading.name:
                options = read_options({**given, "name": form.filename})
        else:
            # What names the request by its body need not hash it once more.
            named = here.fingerprint
            if named is not None:
                named.leave()
            await receive(request, incoming.write)
            if named is not None:
                named.body = incoming.finish()
        # Who waits for a reader waits here and not in a thread: threads are for those who are at work.
        parsers = here.service.parsers
        row = await to_thread.run_sync(_keep, here, incoming, options, limiter=parsers.limiter)
    here.service.metrics.upload(row.size)
    response.headers["Location"] = f"/v1/tables/{row.id}"
    return documents.table(row)


def _keep(here: Mine, incoming: Incoming, options: ReadOptions) -> TableRow:
    """Parse what came; only what is a table becomes a blob and a row."""
    before = here.made_before(TableRow)
    if before is not None:
        return before
    sha256 = incoming.finish()
    # At once: the reading is another process's.
    with ThreadPoolExecutor(1) as beside:
        packing = beside.submit(incoming.pack)
        found = here.service.parsers.parse(incoming.path, options.to_dict(), sha256)
        packing.result()
    row = TableRow(
        id=here.new_id(), created=time.time(), owner=here.caller.owner,
        name=(found.name or options.name or sha256[:12])[:255],
        sha256=sha256, size=incoming.size, options=options.to_dict(), description=found.description,
    )  # fmt: skip
    # Outside first, because it may take long; inside there is nothing to do then, or nearly always.
    here.service.blobs.keep(incoming, sha256)
    with here.service.store.guarding():
        here.service.blobs.keep(incoming, sha256)
        here.service.store.add(row)
    # Here and not by the event loop: bytes that were there before are still to be deleted.
    incoming.discard()
    return row


def _columns(text: str | None) -> dict[str, Any] | None:
    if text is None:
        return None
    try:
        found = orjson.loads(text.encode("utf-8", "replace"))
    except orjson.JSONDecodeError as error:
        raise Problem.invalid(
            "bad-option", f"columns is not JSON: {error.msg}", parameter="columns",
            remedy='give an object, as {"thetai": "theta_i_deg", "5": "brdf_R"}',
        ) from error  # fmt: skip
    return found


@router.post(
    "/{id}/readings", status_code=201, response_model=schemas.TableDocument,
    responses=problems(404, 422),
)  # fmt: skip
async def read_again(
    id: str, response: Response, here: Here, reading: Annotated[ReadingOptions, Query()]
) -> dict[str, Any]:
    """Read a table's bytes once more, with other options: another table, without another upload.

    Options that are not given are those of the table.
    """
    given = reading.model_dump(exclude_unset=True)
    if "columns" in given:
        given["columns"] = _columns(reading.columns)
    row = await to_thread.run_sync(here.get, TableRow, id)
    options = read_options({**row.options, **given})
    with here.service.blobs.incoming(here.service.settings.max_upload_bytes) as incoming:
        await to_thread.run_sync(copy, here.service.blobs, row.sha256, incoming)
        made = await to_thread.run_sync(_keep, here, incoming, options, limiter=here.service.parsers.limiter)
    response.headers["Location"] = f"/v1/tables/{made.id}"
    return documents.table(made)


@router.get("", response_model=schemas.Page[schemas.TableDocument], responses=problems(422))
def tables(
    request: Request, response: Response, here: Here, limit: Limit = 50, offset: Offset = 0
) -> dict[str, Any]:
    """The uploaded tables, newest first."""
    rows, total = here.page(TableRow, limit, offset)
    return page(request, response, [documents.table(row) for row in rows], total, limit, offset)


@router.get("/{id}", response_model=schemas.TableDocument, responses=problems(404, 422))
def table(id: str, here: Here) -> dict[str, Any]:
    """What a table's bytes were read as."""
    return documents.table(here.get(TableRow, id))


@router.delete("/{id}", status_code=204, responses=problems(404, 409, 422))
def delete(id: str, here: Here) -> Response:
    """Delete a table: its row, and its bytes when no other table has the same.

    Finished fits and posteriors stay, with what they say of the table. 409 while a job needs it.
    """
    here.get(TableRow, id)
    try:
        with here.service.store.guarding():
            unused = here.service.store.delete_table(id)
            if unused is not None:
                here.service.blobs.drop(unused)
    except Missing as error:
        raise Problem.not_found("table", id) from error
    except InUse as error:
        raise Problem(
            409, "table-in-use", "a waiting or running job needs this table",
            remedy="cancel the job (POST /v1/jobs/{id}/cancel) or wait for it",
        ) from error  # fmt: skip
    return Response(status_code=204)


@router.post(
    "/{id}/evaluate",
    responses={**problems(400, 404, 413, 422), **array_response(schemas.TableEvaluationDocument)},
    openapi_extra=array_request("wi", "wo"),
)  # fmt: skip
def evaluate(id: str, request: Request, body: Body, here: Here) -> Response:
    """The table's interpolant at direction pairs, and which of them lie outside the measured domain.

    As `.npy` the answer is a structured array with the fields `value` (C,) and `extrapolated`.
    """
    opened = here.service.tables.open(here.get(TableRow, id))
    wi, wo = read_pairs(request, body, here.service.settings.max_pairs)
    values, extrapolated = opened.table.evaluate(wi, wo)
    array = np.zeros(len(values), [("value", np.float64, values.shape[1:]), ("extrapolated", np.bool_)])
    array["value"], array["extrapolated"] = values, extrapolated
    document = {
        "channels": _channels(opened.table), "unit": "1/sr", "values": values, "extrapolated": extrapolated,
    }  # fmt: skip
    return respond(request, document, array)


@router.post(
    "/{id}/samples",
    responses={**problems(400, 404, 413, 422), **array_response(schemas.SamplesDocument)},
)  # fmt: skip
def samples(id: str, request: Request, wanted: schemas.TableSampleRequest, here: Here) -> Response:
    """Directions drawn from the raw table, exactly proportional to f_r cos(theta_o); or pairs of directions,
    proportional to f_r cos(theta_i) cos(theta_o)."""
    row = here.get(TableRow, id)
    if wanted.wi is None:
        limited(wanted.n, here.service.settings.max_draws)
        wi = None
    else:
        wi = checked_draws(wanted.wi, wanted.n, here.service.settings.max_draws)
    opened = here.service.tables.open(row)
    drawn, slices = opened.sample(
        wi, wanted.n, wanted.seed, weights=wanted.weights, method=wanted.method,
        max_evaluations=wanted.max_evaluations, allow_extrapolated=wanted.allow_extrapolated,
    )  # fmt: skip
    return respond_samples(request, drawn, _channels(opened.table), slices)


@router.get(
    "/{id}/content", response_class=Response,
    responses={
        **problems(404, 416, 422),
        200: {"content": {"application/octet-stream": {}}, "description": "The bytes"},
        206: {"content": {"application/octet-stream": {}}, "description": "The range that was asked for"},
    },
)  # fmt: skip
async def content(
    id: str, request: Request, here: Here,
    range: Annotated[str | None, Header(description="one range of bytes", examples=["bytes=0-99"])] = None,
) -> Response:  # fmt: skip
    """The bytes that were uploaded. Read with the table's `options` they are the table again.

    The tag is their sha256. Of a Range with several parts, or in another unit, the whole is sent.
    """
    del range  # documented here, read there
    row = await to_thread.run_sync(here.get, TableRow, id)
    return await respond_content(request, here.service.blobs, row.sha256, row.size)


@router.get("/{id}/info", response_model=schemas.InfoDocument, responses=problems(404, 422))
def info(id: str, here: Here) -> Response:
    """What a table's bytes were read as, its noise and its blind spots, as `brdf-fitter info --json`."""
    found = here.service.tables.open(here.get(TableRow, id)).table
    document = {"kind": "brdf-fitter/table", **describe(found), **overview(found)}
    return Response(dumps(document), media_type="application/json")


@router.get("/{id}/check", response_model=schemas.CheckDocument, responses=problems(404, 422))
def check(id: str, here: Here, seed: Annotated[int, Query(ge=0, lt=2**63)] = 0) -> Response:
    """Quality of the table: noise, reciprocity, energy, missing regions, faulty values, conventions.

    Large grids are judged by a subset drawn with `seed`: the same seed gives the same findings.
    """
    found = fitter.check(here.service.tables.open(here.get(TableRow, id)).table, seed=seed)
    return Response(dumps(found.to_dict()), media_type="application/json")


@router.get(
    "/{id}/picture.png", response_class=Response,
    responses={**problems(404, 422), 200: {"content": {"image/png": {}}, "description": "The picture"}},
)  # fmt: skip
def picture(id: str, here: Here) -> Response:
    """The table's picture: slices through the plane of incidence, angles covered, scattered hemispheres."""
    from fitter.report.portrait import portrait  # matplotlib takes half a second, and only here
    from fitter.report.portrait_figure import draw, png

    found = portrait(here.service.tables.open(here.get(TableRow, id)).table)
    return Response(png(draw(found)), media_type="image/png")


@router.get(
    "/{id}/export/{format}", response_class=Response,
    responses={**export_responses(tables=True), **problems(404, 422)},
)  # fmt: skip
async def export(id: str, format: str, here: Here, channels: ChosenChannels = None) -> Response:
    """The table as a file of another program; `/v1/export-targets` lists the formats."""

    def made() -> Response:
        row = here.get(TableRow, id)
        found = subject(here.service.tables.open(row).table, name=row.name)
        return respond_export(found, format, channels=channels)

    return await in_turn(here, format, made)


def _channels(found: fitter.Table) -> list[str]:
    return [channel.name for channel in found.channels]
