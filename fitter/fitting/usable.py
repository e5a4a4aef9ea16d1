"""Which samples of a table a fit uses, and whether their values can be fitted at all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.errors import FitError, SpecError
from fitter.fitting import metrics
from fitter.fitting.measures import measures
from fitter.fitting.samples import Usable
from fitter.spec import Metric, Select, Weighting
from fitter.summary import Summary, summarise
from fitter.table import Table

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
#: Values beyond this, either way, are refused.
LARGEST = 1e60


def usable(
    table: Table, metric: Metric, select: Select, *, anisotropic: bool = False,
    weighting: Weighting = "samples", floor: FloatArray | None = None,
) -> Usable:  # fmt: skip
    """The samples of ``table`` that a fit under ``metric`` uses. Raises SpecError or FitError.

    ``floor`` : (C,) of the metric, where ``table`` is a part of the one fitted, which may hold none of them.

    ``anisotropic`` : of the model. The directions of an isotropic table are one representative each of all
    azimuths; such a model then gets them turned about the normal, evenly, or it would read meaning into the
    azimuth that the table happens to be written in.
    """
    names = [c.name for c in table.channels]
    for name in select.channels or ():
        if name not in names:
            raise SpecError(
                f"the table has no channel {name!r}", code="unknown-channel", parameter="select.channels",
                remedy=f"its channels are {', '.join(names)}",
            )  # fmt: skip
    channels = tuple(names.index(n) for n in select.channels) if select.channels else tuple(range(len(names)))
    left_out: dict[str, int] = {}
    used = _selected(table, select, left_out)
    summary = _summary(table, used)
    part = floor is not None
    if floor is None:
        floor = summary.typical[list(channels)] * metrics.LOG_FLOOR
        floor = np.where(floor > 0, floor, metrics.LOG_FLOOR)
    if metric in metrics.POSITIVE:
        index = np.flatnonzero(used)
        undefined = index[~(table.value[index][:, list(channels)] > -floor).all(axis=1)]
        left_out[f"too negative for the metric {metric}"] = len(undefined)
        used = _without(used, undefined)
        summary = _summary(table, used)
    left_out = {why: n for why, n in left_out.items() if n}
    if not used.any() and not part:
        raise FitError(
            "no usable sample is left to fit", code="nothing-to-fit",
            cause=", ".join(f"{n} {why}" for why, n in left_out.items()) or "all samples are masked",
            remedy="widen the selection, or choose a metric that the values allow",
        )  # fmt: skip
    summary = summary._make(column[list(channels)] for column in summary)
    if not summary.largest.any() and not part:
        raise FitError(
            "all values are zero", code="nothing-to-fit", cause="a table of fill values",
            remedy="check the value columns",
        )  # fmt: skip
    if not part:
        _check_size(table, metric, used, list(channels), float(summary.largest.max()))
    measure = measures(table, used) if weighting == "solid_angle" else None
    return Usable(
        metric, weighting, table, np.flatnonzero(used), used, channels, floor, summary,
        anisotropic and table.symmetry == "isotropic", measure, left_out,
    )  # fmt: skip


def _selected(table: Table, select: Select, left_out: dict[str, int]) -> NDArray[np.bool_]:
    """(N,) which usable samples lie within the selection's angles; the others are counted."""
    used = table.mask
    limits = (("theta_i", select.theta_i_max_deg), ("theta_o", select.theta_o_max_deg))
    if any(limit is not None for _, limit in limits):
        index = np.flatnonzero(used)
        for (name, limit), w in zip(limits, table.directions(index), strict=True):
            if limit is not None:
                outside = index[w[:, 2] < np.cos(np.deg2rad(limit)) - 1e-12]
                left_out[f"{name} beyond {limit:g} deg"] = int(used[outside].sum())
                used = _without(used, outside)
    return used


def _without(used: NDArray[np.bool_], index: IntArray) -> NDArray[np.bool_]:
    used = used.copy()
    used[index] = False
    return used


def _summary(table: Table, used: NDArray[np.bool_]) -> Summary:
    if used is table.mask:
        return table.summary
    if not used.any():
        zero = np.zeros(table.value.shape[1])
        return Summary(zero, zero, zero, zero)
    return summarise(table.value, used)


def _check_size(
    table: Table, metric: Metric, used: NDArray[np.bool_], channels: list[int], largest: float
) -> None:
    """Sums of fourth powers of values and weights have to stay numbers."""
    heaviest = 1.0
    if metric == "measurement" and table.sigma is not None:
        heaviest = 1.0 / min(float(table.sigma[:, c].min(where=used, initial=np.inf)) for c in channels)
    largest = max(largest, heaviest * largest)
    if not 1.0 / LARGEST < largest < LARGEST or heaviest > LARGEST:
        raise FitError(
            f"values, or values over their uncertainty, as large as {largest:.3g} can't be fitted",
            code="values-out-of-range", cause="a wrong unit, a fill value, or a sigma that is all but zero",
            remedy=f"give values between {1 / LARGEST:g} and {LARGEST:g}, or mask the absurd ones",
        )  # fmt: skip
