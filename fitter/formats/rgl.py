"""EPFL RGL material database: tensor files of samples in an adaptive parameterisation, RGB or spectral.

Each incidence has its own outgoing directions, close together where the surface reflects much. They are
what the table holds: the file's own samples, mapped to directions by its own warp
(:mod:`fitter.sampling.parameterisation`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats import geometry as geo
from fitter.formats.assemble import Reading, assemble, stated_quantity
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.rgl_writer import MEASURED, write_rgl
from fitter.formats.source import Source
from fitter.formats.tensor_file import MAGIC, fields
from fitter.metadata import Channel
from fitter.sampling.adaptive import AdaptiveInterpolant
from fitter.sampling.parameterisation import Adaptive
from fitter.table import Table

FloatArray = NDArray[np.float64]
Fields = dict[str, NDArray[Any]]

NAME = "rgl"
#: Dimensions of the fields that are needed beside the data.
_NEEDED = {"theta_i": 1, "phi_i": 1, "sigma": 2, "ndf": 2, "vndf": 4, "jacobian": 1}
_LONGEST_NAME = 120


def sniff(head: bytes, size: int) -> float:
    """Sure by the first twelve bytes."""
    return 1.0 if head.startswith(MAGIC) else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The table of a tensor file. Samples below the horizon are part of the format: masked, counted."""
    reading, geometry, adaptive = _reading(source, options)
    table = assemble(source, options, reading, geometry)
    table.between = AdaptiveInterpolant(adaptive, reading.quantity)
    return [table]


def _reading(source: Source, options: ReadOptions) -> tuple[Reading, geo.Geometry, Adaptive]:
    # The warp takes several times the file's size: it ends here, before the table is made.
    quantity, notes = stated_quantity(options, "ccbrdf", "f_r cos theta_o")
    found = fields(source)
    adaptive, channels = adaptive_of(source, found)
    wi, wo, values = samples(adaptive)
    notes.append("The samples are the file's own, mapped to directions by its warp.")
    if adaptive.folds > 1:
        low, high = np.rad2deg(adaptive.phi_i[[0, -1]])
        notes.append(
            f"The file holds incident azimuths from {low:.4g} to {high:.4g} deg and states that the rest "
            "repeat them; only those it holds are in the table."
        )
    negative = int(np.count_nonzero((values < 0).any(axis=1) & (wo[:, 2] > 0)))
    if negative:
        notes.append(f"{negative} samples are negative in a channel: noise, or colours outside the gamut.")
    stated = _text(found["description"]) if "description" in found else ""
    usable = _measured(source, found, adaptive, len(values))
    reading = Reading(
        NAME, quantity, values, channels, usable=usable,
        symmetry="isotropic" if adaptive.isotropic else "anisotropic", name=stated[:_LONGEST_NAME],
        provenance={"description": stated, "shape": list(adaptive.data.shape)}, notes=tuple(notes),
        text=False, angle_unit="rad",
    )  # fmt: skip
    if usable is not None and not usable.all():
        hole = np.where(usable, 0.0, np.nan).reshape(len(adaptive.data), 1, *adaptive.data.shape[-2:])
        adaptive = replace(adaptive, data=adaptive.data + hole)
    # A copy, which has no warp yet.
    return reading, geo.from_directions(wi, wo, "adaptive", symmetric=adaptive.isotropic), replace(adaptive)


FORMAT = Format(NAME, "EPFL RGL tensor file, RGB or spectral", (), sniff, read, write=write_rgl)


def samples(adaptive: Adaptive) -> tuple[FloatArray, FloatArray, FloatArray]:
    """``(wi, wo, f_r cos theta_o)`` of all samples, (n, 3), (n, 3) and (n, C), incidence by incidence."""
    count = adaptive.data.shape[-1] * adaptive.data.shape[-2]
    channels = adaptive.data.shape[1]
    wi = np.repeat(adaptive.nodes(), count, axis=0)
    wo, values = np.empty_like(wi), np.empty((len(wi), channels))
    for node, block in enumerate(adaptive.data):
        part = slice(node * count, (node + 1) * count)
        wo[part], factor = adaptive.samples(node)
        # Numbers too large, or none at all, count as missing.
        with np.errstate(over="ignore", invalid="ignore"):
            values[part] = block.reshape(channels, count).T * factor[:, None]
    return wi, wo, values


def adaptive_of(source: Source, found: Fields) -> tuple[Adaptive, list[Channel]]:
    """The measurement that the fields of a file make up, and its channels.

    Raises TableError for fields that are missing, don't fit together, or hold what no surface has.
    """
    key = "rgb" if "rgb" in found else "spectra"
    needed = {**_NEEDED, key: 5, **({"wavelengths": 1} if key == "spectra" else {})}
    missing = [name for name in needed if name not in found]
    if missing:
        raise source.error(
            f"the tensor file has no field {', '.join(missing)}", "table-header", column=missing[0],
            cause="a tensor file of another kind" if len(missing) > 1 else "a damaged file",
            remedy="use a BSDF of the RGL material database",
        )  # fmt: skip
    shapes = {name: found[name].shape for name in needed}
    theta, phi = shapes["theta_i"], shapes["phi_i"]
    channels = (3,) if key == "rgb" else shapes["wavelengths"]
    for name, dimensions in needed.items():
        shape = shapes[name]
        expected = {"vndf": (*phi, *theta), key: (*phi, *theta, *channels)}.get(name, ())
        image = name in (key, "vndf", "ndf", "sigma")
        if len(shape) != dimensions or shape[: len(expected)] != expected or (image and min(shape[-2:]) < 2):
            counts = f"there are {theta[0]} incident angles and {phi[0]} azimuths"
            raise _unfit(source, name, f"has the shape {shape}", counts)
    adaptive = Adaptive(
        theta_i=_angles(source, found, "theta_i", 0.0, np.pi / 2),
        phi_i=_angles(source, found, "phi_i", -2 * np.pi, 2 * np.pi),
        ndf=_image(source, found, "ndf"), sigma=_image(source, found, "sigma"),
        vndf=_image(source, found, "vndf").reshape(-1, *shapes["vndf"][2:]),
        data=found[key].reshape(-1, *shapes[key][2:]), jacobian=bool(found["jacobian"][0]),
    )  # fmt: skip
    if (adaptive.sigma == 0).any():
        at = _first(adaptive.sigma == 0)
        raise _unfit(source, "sigma", f"is 0 at index {at}", "a projected area is positive")
    try:
        _ = adaptive.warp
    except ValueError as error:
        raise _unfit(source, "vndf", "is 0 or too large at an incidence", str(error)) from None
    return adaptive, _channels(source, found, key)


def _channels(source: Source, found: Fields, key: str) -> list[Channel]:
    if key == "rgb":
        return [Channel(c) for c in "RGB"]
    stored = found["wavelengths"]
    with np.errstate(invalid="ignore"):
        wavelengths = np.asarray(stored, np.float64)
    with np.errstate(invalid="ignore"):
        wrong = ~(np.isfinite(wavelengths) & (np.diff(wavelengths, prepend=0.0) > 0))
    if wrong.any():
        at = _first(wrong)
        raise _unfit(source, "wavelengths", f"is {wavelengths[at]:g} at index {at}", "nanometres increase")
    # The shortest number that is the stored one: 633.1, not the nearest float32 with all its digits.
    texts = [np.format_float_positional(nm, trim="-") for nm in stored]
    return [Channel(f"{text}nm", float(text)) for text in texts]


def _angles(source: Source, found: Fields, name: str, low: float, high: float) -> FloatArray:
    """Increasing angles in radians. Half a turn stored as float32 is a little more than half a turn."""
    with np.errstate(invalid="ignore"):
        angles = np.asarray(found[name], np.float64)
    inside = (angles >= low - 1e-6) & (angles <= high + 1e-6)
    with np.errstate(invalid="ignore"):
        wrong = ~inside | np.append(False, ~(np.diff(angles) > 0))
    if wrong.any():
        at = _first(wrong)
        raise _unfit(
            source, name, f"is {angles[at]:g} at index {at}",
            f"angles increase and lie between {low:.4g} and {high:.4g} rad",
        )  # fmt: skip
    return angles


def _image(source: Source, found: Fields, name: str) -> NDArray[np.floating]:
    values = found[name]
    if values.dtype.kind != "f":
        values = values.astype(np.float64)
    wrong = ~np.isfinite(values) | (values < 0)
    if wrong.any():
        at, reason = _first(wrong), "it is a density or an area"
        raise _unfit(source, name, f"is {values[at]:g} at index {at}", reason)
    return values


def _measured(source: Source, found: Fields, adaptive: Adaptive, count: int) -> NDArray[np.bool_] | None:
    if MEASURED not in found:
        return None
    flags = found[MEASURED]
    if flags.size != count:
        raise _unfit(source, MEASURED, f"has the shape {flags.shape}", f"there are {count} samples")
    return np.asarray(flags.reshape(-1) != 0)


def _first(wrong: NDArray[np.bool_]) -> tuple[int, ...]:
    """The index of the first True."""
    return tuple(int(k) for k in np.unravel_index(int(np.argmax(wrong)), wrong.shape))


def _unfit(source: Source, name: str, wrong: str, reason: str) -> Exception:
    return source.error(
        f"the field {name} {wrong}: {reason}", "table-header", column=name, cause="a damaged file",
        remedy="fetch the file again",
    )  # fmt: skip


def _text(field: NDArray[Any]) -> str:
    """A description as one line of printable characters."""
    text = field.astype(np.uint8).tobytes().decode(errors="replace") if field.dtype.kind in "ui" else ""
    # In pieces: the characters of a long one, each a string of its own, take fifty times its size.
    pieces = (text[k : k + 1000] for k in range(0, len(text), 1000))
    plain = ("".join(c if c.isprintable() else " " for c in piece) for piece in pieces)
    return " ".join("".join(plain).split())
