"""Truths: parameter values drawn from the posterior's own prior, over a stated range of it.

The prior of a posterior is flat in the search coordinates (the logarithm of what is searched by its order of
magnitude). Over a part of its range it is flat, too, and draws of the posterior that lie in that part are
draws of the posterior that has this part alone as its prior. So truths drawn from the part and the draws
within it are an exact test, and the part may be where the surfaces are that somebody measures. Linear and
noise parameters are sampled within their part; draws that leave that of another are left out.
Surfaces with several names (lobes in any order, axes swapped with a quarter turn) go by the one that the
posterior uses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.fitting.layout import Layout, channel_groups, layout
from fitter.fitting.order import azimuths, in_order, interchangeable, ordered_axes
from fitter.fitting.result import FitResult
from fitter.fitting.samples import Usable
from fitter.models import ReflectanceModel
from fitter.models.labelled import place, with_values
from fitter.posterior.jackknife import vector

FloatArray = NDArray[np.float64]
#: Truths that are tried until one goes by the name that the posterior uses.
TRIES = 1_000
#: An inferred noise is drawn from 0 to this many times the relative misfit of the fit, its relative part and
#: its floor (of the median value) alike; the misfit itself is taken to be within these ends.
TIMES, LEAST, MOST = 1.5, 0.005, 0.3
NOISE = ("relative_noise", "noise_floor")


@dataclass(frozen=True)
class Truths:
    """The part of the prior that truths are drawn from.

    labels : (P,) flat free parameters, those of an inferred noise last. low, high : (P,) in search
    coordinates. logs : (P,) whether that is the logarithm. groups : positions in ``labels`` of the entries u
    of each group of channels, with the linear parameters of its channels behind them.
    """

    model: ReflectanceModel
    places: Layout
    labels: tuple[str, ...]
    low: FloatArray
    high: FloatArray
    logs: NDArray[np.bool_]
    groups: tuple[tuple[int, ...], ...]

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """One truth (P,) in search coordinates. Raises SpecError where the ranges leave no name to it."""
        for _ in range(TRIES):
            y = rng.uniform(self.low, self.high)
            named = self.named(y[None])
            if self.inside(named)[0] and np.allclose(self.named(named), named) and self._is(y, named[0]):
                return named[0]
        raise SpecError(
            "the ranges hold no surface by the name that a posterior uses", code="bad-ranges",
            parameter="ranges", cause="lobes go from broad to narrow, and alpha_x is at most alpha_y",
            remedy="give ranges in that order, or the same range to both",
        )  # fmt: skip

    def named(self, y: FloatArray) -> FloatArray:
        """Vectors (S, P) by the names that the posterior uses, azimuths near the middle of their range."""
        found = y.copy()
        t = len(self.places.entries)
        for group in self.groups:
            entries = np.array(group[:t], np.intp)
            if interchangeable(self.places) is not None:
                for row in found:
                    row[list(group)] = in_order(self.places, row[list(group)])
            middle = 0.5 * (self.low + self.high)[entries]
            found[:, entries] = ordered_axes(self.places, found[:, entries], middle)
        return found

    def inside(self, y: FloatArray) -> NDArray[np.bool_]:
        """(S,) whether vectors (S, P) lie in the ranges; an azimuth with a whole period always does."""
        open_ = np.zeros(len(self.labels), bool)
        for group in self.groups:
            open_[[group[k] for k in azimuths(self.places)]] = True
        open_ &= self.high - self.low >= math.pi * (1 - 1e-12)
        return np.asarray(((y >= self.low) & (y <= self.high) | open_).all(axis=1))

    @property
    def within(self) -> dict[str, tuple[float, float]]:
        """The ranges of linear and noise parameters, by label: a prior that is no wider has the same
        posterior there, and its draws are not spent on lobes that hide between the samples and may be of any
        strength. Empty where lobes can change places: a range is of a place."""
        if interchangeable(self.places) is not None:
            return {}
        t = len(self.places.entries)
        searched = {k for group in self.groups for k in group[:t]}
        return {
            label: (float(self.low[k]), float(self.high[k]))
            for k, label in enumerate(self.labels)
            if k not in searched
        }

    def search(self, draws: FloatArray, labels: Sequence[str]) -> FloatArray:
        """(S, P) in search coordinates, in this order, from draws in the parameters' own units."""
        columns = draws[:, [labels.index(label) for label in self.labels]]
        return np.where(self.logs, np.log(np.where(self.logs, columns, 1.0)), columns)

    def natural(self, y: FloatArray) -> FloatArray:
        """(..., P) in the parameters' own units."""
        return np.where(self.logs, np.exp(np.where(self.logs, y, 0.0)), y)

    def model_of(self, y: FloatArray) -> ReflectanceModel:
        """The model that a vector (P,) stands for."""
        return with_values(self.model, self.labels, self.natural(y))

    def noise_of(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Relative noise and floor (..., C) of vectors (..., P)."""
        natural = self.natural(y)
        where = [[self.labels.index(f"{kind}[{c}]") for c in self.model.channels] for kind in NOISE]
        return natural[..., where[0]], natural[..., where[1]]

    def _is(self, y: FloatArray, named: FloatArray) -> bool:
        """Whether a draw y has its own name; azimuths are the same half a turn on."""
        period = np.zeros(len(y))
        for group in self.groups:
            period[[group[k] for k in azimuths(self.places)]] = math.pi
        away = y - named
        turns = np.where(period > 0, np.round(away / np.where(period > 0, period, 1.0)) * period, 0.0)
        return bool(np.allclose(away, turns, atol=1e-9))


def truths(
    fit: FitResult, data: Usable, *, inferred: bool, around: float | None,
    ranges: Mapping[str, tuple[float, float]], used: int | None = None,
) -> Truths:  # fmt: skip
    """The part of the prior that is ``around`` so many standard uncertainties of a fit wide, either way, or
    the whole of it (None), but for the parameters whose ``ranges`` are given, by name or label. Of ``used``
    samples the uncertainties are larger.

    Raises SpecError on an unknown name or a range outside the prior's.
    """
    count = len(data.channels)
    places = layout(fit.spec, count)
    declared = {p.name: p for p in fit.model.table}
    names = fit.model.channels
    labels: list[str] = []
    logs: list[bool] = []
    prior: list[tuple[float, float]] = []
    groups: list[tuple[int, ...]] = []
    lower, upper = places.box
    for group in channel_groups(fit.spec, count):
        _, own = vector(places, fit, group)
        first, linear = len(labels), len(places.linear) * len(group)
        labels += own
        logs += [False] * linear + [places.logs[k] for k, _ in places.entries]
        for p in places.linear:
            for k in group:
                # What has no upper end is a reflectance: 1, or what the table's values ask for.
                most = max(1.0, np.pi * float(data.summary.typical[k]))
                prior.append((p.lower, p.upper if math.isfinite(p.upper) else most))
        prior += list(zip(lower, upper, strict=True))
        entries = range(first + linear, len(labels))
        groups.append((*entries, *range(first, first + linear)))
    low, high = np.array(prior, np.float64).T
    wider = math.sqrt(len(data) / (used or len(data)))
    if around is not None:
        low, high = _around(fit, labels, np.array(logs), low, high, around * wider)
    if inferred:
        labels += [f"{kind}[{c}]" for kind in NOISE for c in names]
        logs += [False] * (2 * len(names))
        largest = TIMES * float(np.clip(fit.metrics["relative_rmse"], LEAST, MOST))
        low = np.concatenate([low, np.zeros(2 * len(names))])
        high = np.concatenate([high, np.full(len(names), largest), largest * data.summary.typical])
    for name, (a, b) in ranges.items():
        where = [k for k, label in enumerate(labels) if name in (label, label.partition("[")[0])]
        if not where:
            raise SpecError(
                f"{name} is not a free parameter here", code="bad-ranges", parameter="ranges",
                remedy=f"use {', '.join(labels)}",
            )  # fmt: skip
        for k in where:
            low[k], high[k] = _given(name, a, b, logs[k], None if k >= len(prior) else _limits(
                declared[labels[k].partition("[")[0]].lower, prior[k], logs[k], k in _linear(groups, places)
            ))  # fmt: skip
    return Truths(fit.model, places, tuple(labels), low, high, np.array(logs), tuple(groups))


def _linear(groups: Sequence[tuple[int, ...]], places: Layout) -> set[int]:
    return {k for group in groups for k in group[len(places.entries) :]}


def _limits(lowest: float, prior: tuple[float, float], log: bool, linear: bool) -> tuple[float, float]:
    """What the prior allows, in the parameter's own unit; a linear one may go beyond what is usual."""
    if linear:
        return lowest, math.inf
    return (math.exp(prior[0]), math.exp(prior[1])) if log else prior


def _given(
    name: str, a: float, b: float, log: bool, limits: tuple[float, float] | None
) -> tuple[float, float]:
    least, most = limits or (0.0, math.inf)
    slack = 1e-9 * max(abs(a), abs(b))
    if not (least - slack <= a < b <= most + slack) or (log and a <= 0):
        raise SpecError(
            f"the range {a:g} to {b:g} of {name} doesn't lie in the prior's {least:g} to {most:g}",
            code="bad-ranges", parameter="ranges", remedy="give lower < upper inside it",
        )  # fmt: skip
    return (math.log(a), math.log(b)) if log else (a, b)


def _around(
    fit: FitResult, labels: Sequence[str], logs: NDArray[np.bool_], low: FloatArray, high: FloatArray,
    times: float,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """The ranges narrowed to so many standard uncertainties about the estimates, where they have one."""
    low, high = low.copy(), high.copy()
    for k, label in enumerate(labels):
        name, where = place(label, fit.model.channels)
        estimate = fit.parameters[name]
        at = where if estimate.value.ndim else ()
        y, u = float(estimate.value[at]), float(estimate.standard_uncertainty[at])
        if not u > 0 or not math.isfinite(u):
            continue
        centre, half = (math.log(y), times * u / y) if logs[k] else (y, times * u)
        a, b = max(low[k], centre - half), min(high[k], centre + half)
        if a < b:
            low[k], high[k] = a, b
    return low, high
