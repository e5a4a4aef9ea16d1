"""The bound: floors by channel, and the bound that a table's own noise is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter.errors import SpecError
from fitter.table import Table

FloatArray = NDArray[np.float64]

#: A table noisier than this is not compressed more coarsely.
_MOST = 0.5


def bound_from_noise(table: Table) -> tuple[float, FloatArray]:
    """``(tolerance, floor)``, floor (C,) in 1/sr, with tolerance (|f| + floor) one standard deviation.

    From the table's sigma where it states one: the median of sigma / |f| in the brighter half of the usable
    samples, and the median of sigma in the darkest quarter. Else from repeated geometries and from
    neighbouring samples, as :mod:`fitter.quality.noise` estimates it, which is an upper bound.

    Raises SpecError where the table is too small, or too smooth, to tell.
    """
    # Half a second, and whoever states a bound needs none of it.
    from fitter.quality import noise
    from fitter.quality.measured import Measured

    channels = len(table.channels)
    if table.sigma is not None:
        size, sigma = np.abs(table.value[table.mask]), table.sigma[table.mask]
        bright, dark = size >= np.median(size, axis=0), size <= np.quantile(size, 0.25, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = float(np.median((sigma / size)[bright & (size > 0)]))
        floors = np.array([np.median(sigma[dark[:, k], k]) for k in range(channels)])
    else:
        measured = Measured.of(table, 0, usable=True)
        found = noise.estimate(noise.scatter(measured), noise.smoothness(measured))
        relative = float("nan") if found is None else found.relative
        floors = np.full(channels, float("nan") if found is None else found.floor)
    if not (np.isfinite(relative) and relative > 0 and np.isfinite(floors).all() and (floors > 0).all()):
        raise SpecError(
            "the table does not tell its noise", code="noise-unknown", parameter="tolerance",
            cause="too few samples, or values without noise", remedy="give a tolerance such as 0.01",
        )  # fmt: skip
    tolerance = min(relative, _MOST)
    return tolerance, floors / tolerance


def default_floor(table: Table) -> FloatArray:
    """(C,) 1 % of the median |f| of each channel's usable samples that are not 0; 1 where there are none."""
    floors = np.ones(table.value.shape[1])
    for k in range(len(floors)):
        size = np.abs(table.value[table.mask, k])
        size = size[size > 0]
        if size.size:
            floors[k] = max(float(np.median(0.01 * size)), np.finfo(np.float64).tiny)
    return floors


def given_floor(floor: ArrayLike | Mapping[str, float], names: list[str], usual: FloatArray) -> FloatArray:
    """(C,) from one number, one per channel, or some by name beside the ``usual`` ones. Raises SpecError."""
    if isinstance(floor, Mapping):
        unknown = [name for name in floor if name not in names]
        if unknown:
            raise SpecError(
                f"the table has no channel {unknown[0]!r}", code="unknown-channel", parameter="floor",
                remedy=f"its channels are {', '.join(names)}",
            )  # fmt: skip
        given = np.array([floor.get(name, default) for name, default in zip(names, usual, strict=True)])
    else:
        given = np.asarray(floor, np.float64)
    if given.shape not in ((), (1,), (len(names),)) or not (np.isfinite(given) & (given > 0)).all():
        raise SpecError(
            f"floor must be a positive number, or one per channel ({len(names)})", code="bad-floor",
            parameter="floor", remedy="leave it out for 1 % of each channel's median",
        )  # fmt: skip
    return np.broadcast_to(given, (len(names),)).copy()
