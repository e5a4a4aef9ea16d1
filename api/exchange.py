"""Exchange: arrays that come and go as JSON or, by content negotiation, as Arrow streams or ``.npy``."""

from __future__ import annotations

import struct
import tokenize
from collections.abc import Collection, Mapping, Sequence
from io import BytesIO
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import orjson
from fastapi import Depends, Request, Response
from numpy.lib import format as npy
from numpy.typing import NDArray

from api import arrow_stream
from api.arrow_stream import ARROW
from api.problems import JSON, Problem, is_json, media_type
from fitter import directions
from fitter.documents import dumps

if TYPE_CHECKING:
    from fitter.sampling import Samples

NPY = "application/x-npy"
FloatArray = NDArray[np.float64]

#: A direction's length may be off by this much (rounded decimals); it is then scaled to unit length.
LENGTH_TOLERANCE = 0.01
#: One whose squared length is off by less is exact.
EXACT = 1e-12


async def _body(request: Request) -> bytes:
    return await request.body()


Body = Annotated[bytes, Depends(_body)]


def preferred(accept: str, offered: Collection[str]) -> str:
    """The media type of the answer, from the header Accept: of those offered the client's first, by quality,
    then by order; JSON where it names none."""
    ranked: list[tuple[float, str]] = []
    for part in accept.lower().split(","):
        kind, *options = (piece.strip() for piece in part.split(";"))
        quality = next((option[2:] for option in options if option.startswith("q=")), "1")
        try:
            ranked.append((-float(quality), kind))
        except ValueError:
            ranked.append((-1.0, kind))
    ranked.sort(key=lambda one: one[0])
    return next((kind for q, kind in ranked if q < 0 and kind in offered), JSON)


def read_pairs(request: Request, body: bytes, limit: int) -> tuple[FloatArray, FloatArray]:
    """``(wi, wo)``, each (M, 3): JSON ``{"wi": ..., "wo": ...}``, an Arrow stream or an array (2, M, 3).

    In JSON one wi may serve all wo, and the other way round.
    """
    if _is_npy(request):
        both = _read_npy(body)
        if both.ndim != 3 or both.shape[0] != 2:
            raise _bad(f"the array has shape {both.shape}, expected (2, M, 3)", "body")
        given: Mapping[str, Any] = {"wi": both[0], "wo": both[1]}
    else:
        given = _read_named(request, body, ("wi", "wo"))
    wi, wo = checked(given["wi"], "wi", limit), checked(given["wo"], "wo", limit)
    above_horizon(wi)
    if len(wi) != len(wo) and 1 not in (len(wi), len(wo)):
        raise _bad(f"{len(wi)} directions wi for {len(wo)} directions wo", "wi")
    count = max(len(wi), len(wo))
    return np.broadcast_to(wi, (count, 3)), np.broadcast_to(wo, (count, 3))


def read_incidences(request: Request, body: bytes, limit: int) -> FloatArray:
    """``wi`` (M, 3): JSON ``{"wi": ...}``, an Arrow stream or an array (M, 3)."""
    given = _read_npy(body) if _is_npy(request) else _read_named(request, body, ("wi",))["wi"]
    wi = checked(given, "wi", limit)
    above_horizon(wi)
    return wi


def checked(given: Any, name: str, limit: int) -> FloatArray:
    """Finite unit vectors (M, 3) from what a client sent: one vector or a list of them."""
    try:
        array = np.asarray(given)
    except (ValueError, TypeError, OverflowError) as error:
        raise _bad(f"{name} is not a list of [x, y, z]", name) from error
    if array.dtype.kind not in "fiu" or array.ndim not in (1, 2) or array.shape[-1] != 3 or array.size == 0:
        raise _bad(f"{name} is not a list of [x, y, z]", name)
    w = array.astype(np.float64, copy=False).reshape(-1, 3)
    if len(w) > limit:
        raise Problem.invalid(
            "too-many-directions", f"{name} has {len(w)} directions, the limit is {limit}", parameter=name,
            remedy="ask in several requests",
        )  # fmt: skip
    with np.errstate(over="ignore", invalid="ignore"):
        x, y, z = w.T
        squared = x * x + y * y + z * z  # in a third of the time of einsum
        off = np.abs(squared - 1)
        # Exact input stays exactly what it is. What is not finite compares as false, the largest of it, too.
        if off.max() <= EXACT:
            return w
        unit = np.abs(np.sqrt(squared) - 1) <= LENGTH_TOLERANCE
    if not unit.all():
        at = int(np.argmin(unit))
        what = "is not a unit vector" if np.isfinite(w[at]).all() else "is not finite"
        raise _bad(f"{name} {at + 1} {what}", name, at + 1)
    return np.where((off > EXACT)[:, None], directions.unit(w), w)


def above_horizon(wi: FloatArray) -> None:
    """Raises Problem where light would come from below the surface."""
    below = wi[:, 2] <= 0
    if below.any():
        at = int(np.argmax(below)) + 1
        raise Problem.invalid(
            "below-horizon", f"wi {at} is not above the horizon", parameter="wi", row=at,
            remedy="directions point away from the surface: wi needs a positive z",
        )  # fmt: skip


def respond(
    request: Request,
    document: Mapping[str, Any],
    array: NDArray[Any],
    headers: Mapping[str, str] | None = None,
) -> Response:
    """``array`` as an Arrow stream or ``.npy`` where the client prefers that, else ``document`` as JSON."""
    both = {"Vary": "Accept", **(headers or {})}
    kind = preferred(request.headers.get("accept", ""), (JSON, NPY, ARROW))
    if kind == JSON:
        return Response(dumps(document), media_type=kind, headers=both)
    if kind == ARROW:
        about = {"channels": ",".join(document.get("channels", ())), **(headers or {})}
        return Response(arrow_stream.packed(array, "value", about), media_type=kind, headers=both)
    buffer = BytesIO()
    npy.write_array(buffer, np.ascontiguousarray(array), allow_pickle=False)
    return Response(buffer.getvalue(), media_type=kind, headers=both)


def respond_samples(
    request: Request, drawn: Samples, channels: Sequence[str], slices: list[dict[str, Any]] | None = None
) -> Response:
    """Draws as JSON, or as a structured array with the acceptance and the seed in headers."""
    sampler = request.url.path.split("/")[2].removesuffix("s")
    request.app.state.service.metrics.acceptance(sampler, drawn.acceptance)
    fields = ("wo", "pdf", "weight", "valid", "is_delta")
    columns = {name: getattr(drawn, name) for name in fields}
    if drawn.wi is not None:
        columns["wi"] = drawn.wi
    array = np.zeros(len(drawn), [(name, c.dtype, c.shape[1:]) for name, c in columns.items()])
    for name, column in columns.items():
        array[name] = column
    document = {
        "channels": list(channels), "wi": None, **columns, "acceptance": drawn.acceptance,
        "evaluations": drawn.evaluations, "seed": drawn.seed, "slices": slices,
    }  # fmt: skip
    headers = {
        "Sampling-Acceptance": f"{drawn.acceptance:.6g}", "Sampling-Evaluations": str(drawn.evaluations),
        "Sampling-Seed": str(drawn.seed),
    }  # fmt: skip
    return respond(request, document, array, headers)


def checked_draws(wi: Sequence[Any], n: int, limit: int) -> FloatArray:
    """The incidence (3,), or incidences (M, 3), of a request for ``n`` draws each."""
    several = isinstance(wi[0], list)
    limited(n * len(wi) if several else n, limit)
    incidences = checked(wi, "wi", len(wi) if several else 1)
    above_horizon(incidences)
    return incidences if several else incidences[0]


def limited(n: int, limit: int) -> None:
    """Raises Problem where ``n`` draws are too many for one answer."""
    if n > limit:
        raise Problem.invalid(
            "too-many-draws", f"{n} draws are more than the limit of {limit}", parameter="n",
            remedy="ask several times, with other seeds",
        )  # fmt: skip


def _is_npy(request: Request) -> bool:
    return media_type(request) == NPY


def _read_named(request: Request, body: bytes, names: tuple[str, ...]) -> Mapping[str, Any]:
    kind = media_type(request)
    if kind == ARROW:
        return arrow_stream.unpacked(body, names)
    if kind and not is_json(kind):
        raise Problem.unsupported(kind, [JSON, NPY, ARROW])
    return _read_json(body, names)


def _read_json(body: bytes, names: tuple[str, ...]) -> Mapping[str, Any]:
    try:
        given = orjson.loads(body)
    except orjson.JSONDecodeError as error:
        raise Problem(400, "bad-json", f"the body is not JSON: {error.msg}", row=error.lineno) from error
    if not isinstance(given, dict):
        raise Problem.invalid("bad-request", "the body is not a JSON object")
    for name in names:
        if name not in given:
            raise Problem.invalid("bad-request", f"{name} is missing", parameter=name)
    for name in given:
        if name not in names:
            raise Problem.invalid(
                "bad-request", f"there is no field {name[:64]!r}", parameter=name[:64],
                remedy=f"the fields are {', '.join(names)}",
            )  # fmt: skip
    return given


def _read_npy(body: bytes) -> NDArray[Any]:
    # The header is read apart, so that the size it claims is compared with the bytes that came.
    stream = BytesIO(body)
    try:
        version = npy.read_magic(stream)
        read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
        shape, fortran, dtype = read(stream)
    except (
        ValueError, TypeError, KeyError, SyntaxError, RecursionError, MemoryError, OverflowError, EOFError,
        struct.error, tokenize.TokenError,
    ) as error:  # fmt: skip
        raise Problem(400, "bad-npy", "the body is not an .npy array") from error
    rest = len(body) - stream.tell()
    if dtype.kind != "f" or any(n < 0 for n in shape) or _product(shape) * dtype.itemsize != rest:
        raise Problem(
            400, "bad-npy", f"the array claims to be {dtype} {shape}, its {rest} bytes are not",
            remedy="send float64 or float32 with numpy.save",
        )  # fmt: skip
    return np.frombuffer(body, dtype, offset=stream.tell()).reshape(shape, order="F" if fortran else "C")


def _product(shape: tuple[int, ...]) -> int:
    total = 1
    for n in shape:  # Python's integers don't overflow
        total *= n
    return total


def _bad(detail: str, name: str, row: int | None = None) -> Problem:
    return Problem.invalid(
        "bad-directions", detail, parameter=name, row=row,
        remedy="give finite unit vectors [x, y, z] that point away from the surface",
    )  # fmt: skip
