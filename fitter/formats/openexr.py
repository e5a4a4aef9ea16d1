"""OpenEXR: slices of a table, one picture an incidence (this program's own layout), and UTIA's database.

Slices are parts of one file. Rows of a part are outgoing polar angles, columns azimuths, both listed in the
header of the first part in radians; attributes ``brdf.theta_i`` and ``brdf.phi_i`` of a part say where the
light is. Channels are f_r in 1/sr as float32, NaN where nothing was measured; ``sigma.<name>`` their standard
uncertainties; ``usable`` is 0 for samples masked by their source. Other ``brdf.*`` attributes are the header
lines of delimited text.
"""

from __future__ import annotations

import json
from collections.abc import Generator, Sequence
from contextlib import contextmanager, redirect_stdout
from io import BytesIO, StringIO
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.errors import TableError
from fitter.formats import openexr_writer, utia
from fitter.formats.arrays import Variable, tables_of
from fitter.formats.openexr_header import damage
from fitter.formats.openexr_writer import AXES, PREFIX, VERSION, WORD
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.source import Source
from fitter.grid import GRID_AXES
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "openexr"
MAGIC = b"\x76\x2f\x31\x01"
#: Bytes of pixels a file may unpack to, and how many for one of its own: what deflate makes of equal ones.
LARGEST, _UNPACKED = 1 << 30, 1032
_SMALL = 1 << 22


def sniff(head: bytes, size: int) -> float:
    """Sure by the first four bytes."""
    return 1.0 if head.startswith(MAGIC) else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The table of slices, or of a UTIA file. Raises TableError for any other picture."""
    stream = _Stream(source.data)
    with _refusing(source, stream):
        parts = _parts(stream, pixels=False)
        shapes = [_shape(part) for part in parts]
        channels = [[str(channel.name) for channel in part.header["channels"]] for part in parts]
        said = {
            str(key).removeprefix(PREFIX): value for key, value in parts[0].header.items()
            if str(key).startswith(PREFIX) and isinstance(value, str)
        }  # fmt: skip
    pixels = sum(prod(shape) * len(names) for shape, names in zip(shapes, channels, strict=True))
    if 4 * pixels > min(LARGEST, max(_UNPACKED * source.size, _SMALL)):
        raise source.error(
            f"the header claims {pixels:,} values in a file of {source.size:,} bytes", "table-truncated",
            column="dataWindow", cause="a damaged header", remedy="fetch the file again",
        )  # fmt: skip
    if WORD in said:
        return _slices(source, options, said)
    if len(parts) == 1 and shapes[0] == utia.SIDES and {"R", "G", "B"} <= set(channels[0]):
        with _refusing(source, stream):
            found = _parts(stream, pixels=True)[0].channels
            planes = np.stack([np.asarray(found[name].pixels, np.float64) for name in "RGB"])
        return [utia.from_picture(source, options, planes)]
    raise source.error(
        "the picture says nothing about directions", "table-header", column=PREFIX + WORD,
        cause="a rendered or measured image",
        remedy="use slices that this program wrote, or a BRDF of the UTIA database (288 x 288 pixels, RGB)",
    )  # fmt: skip


FORMAT = Format(
    NAME, "OpenEXR slices, one picture an incidence, and UTIA's OpenEXR files", utia.CONVENTIONS, sniff, read,
    write=openexr_writer.write,
)  # fmt: skip


class _Stream(BytesIO):
    """The file as OpenEXR reads it. place : the byte at which it last read something."""

    place = 0

    def read(self, size: int | None = -1) -> bytes:
        at = self.tell()
        piece = super().read(size)
        if piece:
            self.place = at
        return piece


@contextmanager
def _refusing(source: Source, stream: _Stream | None = None, column: str | None = None) -> Generator[None]:
    """Turn what OpenEXR raises at damaged bytes of ``stream``, or at an attribute, into a TableError."""
    try:
        yield
    except TableError:
        raise
    except (ArithmeticError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:120]
        offset = None
        if stream is not None:
            # The header is read at once, a part's pixels each for themselves.
            found = damage(source.buffer)
            offset, column = (stream.place, column) if found is None else (found.offset, found.attribute[:40])
        raise source.error(
            f"the OpenEXR file can't be read{': ' if reason else ''}{reason}", "table-truncated",
            column=column or None, offset=offset, cause="the file is cut off or damaged",
            remedy="fetch the file again",
        ) from error  # fmt: skip


def _parts(stream: _Stream, *, pixels: bool) -> list[Any]:
    import OpenEXR

    # What goes wrong with a part's pixels is printed, and the part left out.
    stream.seek(0)
    with redirect_stdout(StringIO()) as printed:
        file: Any = OpenEXR.File(stream, True, not pixels, 0)
    parts: list[Any] = list(file.parts)
    if not parts or printed.getvalue():
        raise ValueError(printed.getvalue() or "no picture in it")
    return parts


def _shape(part: Any) -> tuple[int, int]:
    low, high = (np.asarray(corner, np.int64) for corner in part.header["dataWindow"])
    width, height = (high - low + 1).tolist()
    if width < 1 or height < 1:
        raise ValueError("a picture without pixels")
    return height, width


def _slices(source: Source, options: ReadOptions, said: dict[str, str]) -> list[Table]:
    if said.pop(WORD) != VERSION:
        raise _bad(source, WORD, "slices of another version")
    said.pop("holds", None)  # for people
    if options.convention not in (None, "phi_specular_180"):
        raise source.error(
            f"convention {options.convention!r} is not for slices", "table-convention",
            parameter="convention", remedy="leave it out",
        )  # fmt: skip
    system = said.pop("system", "")
    names = [name for name in GRID_AXES.get(system, ()) if name in AXES.get(system, ())]
    if not names:
        raise _bad(source, "system", f"slices of the system {system[:40]!r}")
    incident, outgoing = names[:-2], names[-2:]
    axes: dict[str, FloatArray] = {}
    stream = _Stream(source.data)
    with _refusing(source, stream):
        parts = _parts(stream, pixels=True)
    light = np.empty((len(parts), len(incident)))
    for k, name in enumerate(incident):
        with _refusing(source, column=PREFIX + name):
            light[:, k] = [float(part.header[PREFIX + name]) for part in parts]
        said.pop(name, None)
    for name in outgoing:
        with _refusing(source, column=PREFIX + name):
            axes[name] = np.array(json.loads(said.pop(name)), np.float64)
    with _refusing(source, column=PREFIX + "pixels"):
        labels: dict[str, str] = dict(json.loads(said.pop("pixels")))
    for k, name in enumerate(incident):
        axes[name] = np.unique(light[:, k])
    shape = tuple(len(axes[name]) for name in names)
    mesh = np.meshgrid(*(axes[name] for name in incident), indexing="ij")
    order = np.lexsort(light.T[::-1])
    expected = np.stack([c.reshape(-1) for c in mesh], axis=1)
    if any(axis.ndim != 1 for axis in axes.values()) or not np.array_equal(light[order], expected):
        raise _bad(source, "theta_i", "slices that are not those of a grid of incidences")
    pixels: dict[str, NDArray[Any]] = {}
    for label, name in labels.items():
        with _refusing(source, column=str(name)[:40]):
            pixels[label] = np.stack([parts[k].channels[name].pixels for k in order])
    if any(array.shape != (len(parts), *shape[-2:]) for array in pixels.values()):
        raise _bad(source, outgoing[0], "pictures of another size than their angles")
    variables = [_variable(f"{name}_rad", (name,), axes[name]) for name in names]
    variables += [_variable(label, tuple(names), array.reshape(shape)) for label, array in pixels.items()]
    return tables_of(source, options, variables, said, format=NAME)


def _variable(name: str, dimensions: Sequence[str], data: NDArray[Any]) -> Variable:
    return Variable(name, tuple(dimensions), data.shape, {}, lambda: data)


def _bad(source: Source, key: str, what: str) -> Exception:
    return source.error(
        f"the file holds {what}", "table-header", column=PREFIX + key, cause="a damaged header",
        remedy="write the table again",
    )  # fmt: skip
