"""WINDOW's XML with a Klems matrix, wrapped by Radiance: 145 x 145 patches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.export import patches, sampling
from fitter.export.fidelity import of_function
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject

FloatArray = NDArray[np.float64]

#: The full basis: borders of its bands in degrees, and patches in each (W. Klems 1994).
_BORDERS = np.array([0, 5, 15, 25, 35, 45, 55, 65, 75, 90.0])
_COUNTS = np.array([1, 8, 16, 20, 24, 24, 24, 16, 12])
_POINTS = 32


def write(subject: Subject, path: Path) -> Written:
    patches.radiance()
    sampling.hemisphere(subject, "a Klems matrix")
    count = int(_COUNTS.sum())

    def place(index: NDArray[np.intp], at: FloatArray) -> tuple[FloatArray, FloatArray]:
        outgoing, incident = np.divmod(index, count)
        travel = _within(incident, at[:, :2])
        return travel * [-1.0, -1.0, 1.0], _within(outgoing, at[:, 2:])

    values, note = patches.averages(subject, (count, count), place, _POINTS)
    lines = ("\t".join(f"{value:.7g}" for value in row) for row in values.tolist())
    patches.wrapped(subject, path, "kf", ("\n".join(lines) + "\n").encode())

    def there(wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        found = values[_patch(wo), _patch(wi * [-1.0, -1.0, 1.0])]
        return found[:, None], np.zeros(len(wi), bool)

    distance = of_function(subject, there, "patch by patch")
    return Written((note, distance, patches.reflectance(subject, there), patches.reciprocity(subject, path)))


def _patch(w: FloatArray) -> NDArray[np.intp]:
    """The patch that each direction lies in."""
    theta, phi = directions.spherical_from_vector(w)
    band = np.clip(np.searchsorted(_BORDERS, np.rad2deg(theta), side="right") - 1, 0, len(_COUNTS) - 1)
    count = _COUNTS[band]
    first = np.concatenate([[0], np.cumsum(_COUNTS)])[band]
    return (first + np.rint(phi / (2 * np.pi) * count).astype(np.intp) % count).astype(np.intp)


def _within(patch: NDArray[np.intp], at: FloatArray) -> FloatArray:
    """Directions (M, 3) inside patches, even in projected solid angle."""
    band = np.repeat(np.arange(len(_COUNTS)), _COUNTS)[patch]
    first = np.concatenate([[0], np.cumsum(_COUNTS)])[band]
    low, high = (np.sin(np.deg2rad(_BORDERS[k])) ** 2 for k in (band, band + 1))
    theta = np.arcsin(np.sqrt(low + (high - low) * at[:, 0]))
    # Patch 0 of a band is centred on azimuth 0.
    phi = 2 * np.pi * (patch - first + at[:, 1] - 0.5) / _COUNTS[band]
    return directions.vector_from_spherical(theta, phi)


TARGET = Target(
    "klems", "WINDOW BSDF XML, a Klems matrix of 145 x 145 patches, by Radiance's wrapBSDF", True, True,
    ".xml",
    "f_r in 1/sr, without the cosine, averages over patches; the side of +z is Reflection Back", write,
    "application/xml", channels=(1,), needs="pyradiance",
)  # fmt: skip
