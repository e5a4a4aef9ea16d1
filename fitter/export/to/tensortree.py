"""WINDOW's XML with a tensor tree, reduced and wrapped by Radiance: fine where the reflectance changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter.export import patches, sampling, tree
from fitter.export.fidelity import of_function
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject
from fitter.formats.tensor_tree import disk_from_square

FloatArray = NDArray[np.float64]

#: Halvings of each side, and points a cell, of isotropic and anisotropic subjects.
_ISOTROPIC, _ANISOTROPIC = (6, 16), (5, 8)
#: Share (percent) of the leaves that Radiance is to cull: as its genBSDF does by default, and less of a tree
#: that is coarse anyway, whose reflectance would change by several percent.
_CULL_ISOTROPIC, _CULL_ANISOTROPIC = 90, 60


def write(subject: Subject, path: Path) -> Written:
    tools = patches.radiance()
    sampling.hemisphere(subject, "a tensor tree")
    isotropic = subject.symmetry == "isotropic"
    level, points = _ISOTROPIC if isotropic else _ANISOTROPIC
    n = 1 << level
    # Half of the first side of an isotropic tree stands for no incidence.
    shape = (n // 2, n, n) if isotropic else (n, n, n, n)

    def place(index: NDArray[np.intp], at: FloatArray) -> tuple[FloatArray, FloatArray]:
        cell = np.stack(np.unravel_index(index, shape), axis=1)
        if isotropic:
            along = 1.0 - 2.0 * (cell[:, 0] + at[:, 0]) / n
            travel = np.stack([along, np.zeros_like(along)], axis=1)
        else:
            travel = disk_from_square((cell[:, :2] + at[:, :2]) / n)
        return _raised(-travel), _raised(disk_from_square((cell[:, -2:] + at[:, 2:]) / n))

    values, note = patches.averages(subject, shape, place, points)
    cull = _CULL_ISOTROPIC if isotropic else _CULL_ANISOTROPIC
    reduced = tools.util.rttree_reduce(
        values.astype("<f4").tobytes(), len(shape), level, pctcull=cull, inform="f", header=False
    )
    patches.wrapped(subject, path, f"t{len(shape)}", reduced)
    value = tree.reader(path, isotropic)

    def there(wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        return value(wi, wo)[:, None], np.zeros(len(wi), bool)

    distance = of_function(subject, there, "patch by patch")
    return Written((note, distance, patches.reflectance(subject, there), patches.reciprocity(subject, path)))


def _raised(disk: FloatArray) -> FloatArray:
    z = np.sqrt(np.maximum(1.0 - (disk * disk).sum(axis=1), 0.0))
    return np.concatenate([disk, z[:, None]], axis=1)


TARGET = Target(
    "tensor-tree", "WINDOW BSDF XML, a tensor tree, by Radiance's rttree_reduce and wrapBSDF", True, True,
    ".xml", "f_r in 1/sr, without the cosine, averages over patches; the side of +z is Reflection Back",
    write,
    "application/xml", channels=(1,), needs="pyradiance",
)  # fmt: skip
