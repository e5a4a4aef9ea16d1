"""WINDOW's XML with a Klems matrix, wrapped by Radiance: 145 x 145 patches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.export import energy, patches, sampling
from fitter.export.fidelity import of_function
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject

FloatArray = NDArray[np.float64]

#: The full basis: borders of its bands in degrees, and patches in each (W. Klems 1994).
_BORDERS = np.array([0, 5, 15, 25, 35, 45, 55, 65, 75, 90.0])
_COUNTS = np.array([1, 8, 16, 20, 24, 24, 24, 16, 12])
#: Pairs of directions in a pair of patches, and in so many where values differ most.
_POINTS, _MORE, _MOST = 32, 1024, 4096


def write(subject: Subject, path: Path) -> Written:
    patches.radiance()
    sampling.hemisphere(subject, "a Klems matrix")
    count = int(_COUNTS.sum())

    def place(pair: NDArray[np.intp], at: FloatArray) -> tuple[FloatArray, FloatArray]:
        outgoing, incident = pair.T
        travel = _within(incident, at[:, :2])
        return travel * [-1.0, -1.0, 1.0], _within(outgoing, at[:, 2:])

    averages = patches.Averages(subject)
    pairs = np.stack([c.reshape(-1) for c in np.indices((count, count))], axis=1)
    mean, spread = averages.over(pairs, place, _POINTS)
    # Where values differ most, more of them.
    most = np.argsort(-spread * _areas()[pairs[:, 0]])[:_MOST]
    mean[most], _ = averages.over(pairs[most], place, _MORE)
    values = mean.reshape(count, count)
    often = np.zeros(len(pairs), bool)
    often[most] = True
    often = often.reshape(values.shape)
    area = np.pi * _areas()[:, None]
    rest, some = ((area * values * which).sum(axis=0) for which in (~often, often))
    values[often] *= np.broadcast_to(energy.scale(_reflectance(subject), rest, some), values.shape)[often]
    lines = ("\t".join(f"{value:.7g}" for value in row) for row in values.tolist())
    patches.wrapped(subject, path, "kf", ("\n".join(lines) + "\n").encode())

    def there(wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        found = values[_patch(wo), _patch(wi * [-1.0, -1.0, 1.0])]
        return found[:, None], np.zeros(len(wi), bool)

    said = f"{_POINTS} pairs of directions each, {_MORE} where they differ most"
    distance = of_function(subject, there, "patch by patch")
    return Written(
        (
            averages.note(said),
            distance,
            patches.reflectance(subject, there),
            patches.reciprocity(subject, path),
        )
    )


def _patch(w: FloatArray) -> NDArray[np.intp]:
    """The patch that each direction lies in."""
    theta, phi = directions.spherical_from_vector(w)
    band = np.clip(np.searchsorted(_BORDERS, np.rad2deg(theta), side="right") - 1, 0, len(_COUNTS) - 1)
    count = _COUNTS[band]
    first = np.concatenate([[0], np.cumsum(_COUNTS)])[band]
    return (first + np.rint(phi / (2 * np.pi) * count).astype(np.intp) % count).astype(np.intp)


def _areas() -> FloatArray:
    """What part of the hemisphere's projected solid angle each patch is."""
    rings = np.diff(np.sin(np.deg2rad(_BORDERS)) ** 2)
    return np.repeat(rings / _COUNTS, _COUNTS)


def _reflectance(subject: Subject) -> FloatArray:
    """The mean reflectance of incidences in each patch."""
    at = (np.stack([c.reshape(-1) for c in np.indices((4, 4))], axis=1) + 0.5) / 4
    patch = np.repeat(np.arange(int(_COUNTS.sum())), len(at))
    wi = _within(patch, np.tile(at, (int(_COUNTS.sum()), 1))) * [-1.0, -1.0, 1.0]
    return energy.reflectance(subject, wi).reshape(-1, len(at)).mean(axis=1)


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
