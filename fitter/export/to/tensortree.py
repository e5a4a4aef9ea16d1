"""WINDOW's XML with a tensor tree, wrapped by Radiance: fine where the reflectance changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter.export import energy, growing, patches, sampling, tree
from fitter.export.fidelity import of_function
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject
from fitter.formats.tensor_tree import disk_from_square

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

#: Halvings of each side at least and at most, and points a cell, of isotropic and anisotropic subjects.
_ISOTROPIC, _ANISOTROPIC = (6, 9, 16), (5, 7, 8)


def write(subject: Subject, path: Path) -> Written:
    patches.radiance()
    sampling.hemisphere(subject, "a tensor tree")
    isotropic = subject.symmetry == "isotropic"
    rank = 3 if isotropic else 4
    first, deepest, points = _ISOTROPIC if isotropic else _ANISOTROPIC
    averages = patches.Averages(subject)

    def average(level: int, cells: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        n = 1 << level

        def place(cell: IntArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
            if isotropic:
                along = 1.0 - 2.0 * (cell[:, 0] + at[:, 0]) / n
                travel = np.stack([along, np.zeros_like(along)], axis=1)
            else:
                travel = disk_from_square((cell[:, :2] + at[:, :2]) / n)
            return _raised(-travel), _raised(disk_from_square((cell[:, -2:] + at[:, 2:]) / n))

        mean, spread, part = np.zeros(len(cells)), np.zeros(len(cells)), np.zeros(len(cells))
        # Half of the first side of an isotropic tree stands for no incidence.
        used = np.flatnonzero(2 * cells[:, 0] < n) if isotropic else np.arange(len(cells))
        mean[used], spread[used] = averages.over(cells[used], place, points)
        # By the solid angle of the incidences, not the projected one: those at grazing are as many.
        centre = place(cells[used], np.full((len(used), 4), 0.5))[0]
        part[used] = 1 / centre[:, 2]
        if isotropic:
            part[used] *= np.hypot(centre[:, 0], centre[:, 1])
        part /= n**rank
        return mean, spread, part

    centres = (np.arange(1 << deepest) + 0.5) / (1 << deepest)
    if isotropic:
        travel = np.stack([np.maximum(1.0 - 2.0 * centres, 0.0), 0 * centres], axis=1)
    else:
        grid = np.meshgrid(centres, centres, indexing="ij")
        travel = disk_from_square(np.stack([c.reshape(-1) for c in grid], axis=1))
    known = energy.reflectance(subject, _raised(-travel)).reshape((1 << deepest,) * (rank - 2))
    text = growing.grown(average, known, rank, first)
    patches.wrapped(subject, path, f"t{rank}", text.encode())
    value = tree.reader(path, isotropic)

    def there(wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        return value(wi, wo)[:, None], np.zeros(len(wi), bool)

    distance = of_function(subject, there, "patch by patch")
    note = averages.note(f"{points} pairs of directions each")
    return Written((note, distance, patches.reflectance(subject, there), patches.reciprocity(subject, path)))


def _raised(disk: FloatArray) -> FloatArray:
    z = np.sqrt(np.maximum(1.0 - (disk * disk).sum(axis=1), 0.0))
    return np.concatenate([disk, z[:, None]], axis=1)


TARGET = Target(
    "tensor-tree", "WINDOW BSDF XML, a tensor tree, by Radiance's wrapBSDF", True, True,
    ".xml", "f_r in 1/sr, without the cosine, averages over patches; the side of +z is Reflection Back",
    write,
    "application/xml", channels=(1,), needs="pyradiance",
)  # fmt: skip
