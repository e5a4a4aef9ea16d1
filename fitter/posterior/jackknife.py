"""robust: what the parameters' uncertainty is where the residuals are misfit, correlated along scans.

Whole scans are left out, one after the other: what the estimates would have been is one Newton step away,
with the exact derivative of the estimating equation (B. Efron, "The Jackknife, the Bootstrap and Other
Resampling Plans", 1982). The spread of those estimates has G - 1 degrees of freedom for G scans. Few scans
say little of their own spread: then the residuals' correlation over directions is estimated, too, and the
larger of the two uncertainties is stated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter.compression import CompressedTable
from fitter.documents import finite_or_none
from fitter.fitting import metrics
from fitter.fitting.blocks import BLOCK, padded
from fitter.fitting.chunks import CHUNK
from fitter.fitting.covariance import settled, to_natural
from fitter.fitting.layout import Layout, channel_groups, layout
from fitter.fitting.polish import normal_equations
from fitter.fitting.result import FitResult
from fitter.fitting.samples import Usable
from fitter.fitting.sums import scan_sums
from fitter.fitting.usable import usable
from fitter.posterior.correlated import correlated_outer
from fitter.selection.blocks import blocks
from fitter.student import coverage_factor
from fitter.table import Table

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]
LEVEL = 0.95
#: Fewer scans than this say too little of their own spread.
ENOUGH_SCANS = 6
#: A scan is taken to leave at least this share of what is known along any direction: one step is no guide to
#: what estimates would do that hang on one scan alone.
LEAST_LEFT = 0.05
#: A parameter rests on a scan that moves it by more than this share of its standard uncertainty.
RESTS = 0.7
#: A direction of the exact curvature below this share of the Gauss-Newton one is not convex enough to use.
CONVEX = 1e-3


@dataclass(frozen=True)
class Robust:
    """Standard uncertainties that hold where the residuals of a scan belong together.

    standard_uncertainty : by flat label ("alpha", "kd[R]"), NaN where none can be stated.
    covariance : (Q, Q) of the jackknife, or of the correlated residuals where there are no scans to leave
        out, in the order of ``labels``; NaN where none is stated, and between channels that are fitted apart.
    degrees_of_freedom, coverage_factor : of Student's t for a 95 % interval; infinite and 1.96 where no scan
        could be left out.
    method : "jackknife"; "larger" of it and the correlated residuals' where scans are few; "correlated" alone
        where there are none. scans, words : what was left out.
    effective_samples : how many independent samples the residuals are worth, per channel of the fit.
    rests_on : by label, the scan that moves it most and by how many of its own standard uncertainties.
    """

    labels: tuple[str, ...]
    standard_uncertainty: Mapping[str, float]
    covariance: FloatArray
    degrees_of_freedom: float
    coverage_factor: float
    method: str
    scans: int
    words: str
    effective_samples: tuple[float, ...]
    rests_on: Mapping[str, tuple[int, float]]

    def to_dict(self) -> dict[str, Any]:
        return {
            "labels": list(self.labels),
            "standard_uncertainty": {
                k: finite_or_none(np.asarray(v)) for k, v in self.standard_uncertainty.items()
            },
            "covariance": finite_or_none(self.covariance),
            "degrees_of_freedom": finite_or_none(np.asarray(self.degrees_of_freedom)),
            "coverage_factor": self.coverage_factor,
            "level": LEVEL,
            "method": self.method,
            "scans": self.scans,
            "words": self.words,
            "effective_samples": list(self.effective_samples),
            "rests_on": {k: {"scan": scan, "share": share} for k, (scan, share) in self.rests_on.items()},
        }


def robust(table: Table | CompressedTable, fit: FitResult) -> Robust:
    """Robust uncertainties of a fit's parameters from the table that was fitted.

    They belong to the best-fitting parameters of the model over the measured directions. Of a large table an
    evenly spaced part is looked at.

    Raises
    ------
    SpecError : the table lacks a channel of the fit.
    """
    whole = table.decompress() if isinstance(table, CompressedTable) else table
    data = used_by(whole, fit)
    rows, _ = data.evenly(BLOCK // 2)
    if len(rows) > BLOCK:
        rows = rows[np.linspace(0, len(rows) - 1, BLOCK).astype(np.intp)]
    pair = data.part([0], rows, len(rows)).pair
    wi, wo = pair[:3].T, pair[3:].T
    isotropic = fit.model.isotropic(fit.spec.model)
    dealt = blocks(wi, wo, ENOUGH_SCANS, isotropic=isotropic)
    scans = dealt.count if dealt.kind is not None else 0
    label = dealt.block if scans else np.zeros(len(rows), np.intp)

    places = layout(fit.spec, len(data.channels))
    spread: dict[str, float] = {}
    rests: dict[str, tuple[int, float]] = {}
    covariance = np.full((len(fit.labels), len(fit.labels)), np.nan)
    worth: list[float] = []
    for group in channel_groups(fit.spec, len(data.channels)):
        one = _group(places, fit, data, rows, label, scans, group, isotropic=isotropic)
        worth += one.effective_samples
        where = [fit.labels.index(name) for name in one.labels]
        covariance[np.ix_(where, where)] = one.covariance
        for k, name in enumerate(one.labels):
            spread[name] = float(one.uncertainty[k])
            if scans and np.isfinite(one.most[k]) and one.most[k] > RESTS:
                rests[name] = (int(one.which[k]), float(one.most[k]))
    freedom = float(scans - 1) if scans else math.inf
    return Robust(
        labels=fit.labels,
        standard_uncertainty={name: spread.get(name, math.nan) for name in fit.labels},
        covariance=covariance,
        degrees_of_freedom=freedom,
        coverage_factor=float(coverage_factor(freedom, LEVEL)),
        method="correlated" if not scans else "larger" if scans < ENOUGH_SCANS else "jackknife",
        scans=scans,
        words=dealt.words.partition(" in ")[0],
        effective_samples=tuple(worth),
        rests_on=rests,
    )


def used_by(table: Table, fit: FitResult) -> Usable:
    """The samples of the fit. Raises SpecError where its channels are not the table's."""
    fit.columns_of(table)
    metric = fit.spec.metric or metrics.default(table.sigma is not None)
    anisotropic = not fit.model.isotropic(fit.spec.model)
    weighting = metrics.weighting(metric, fit.spec.weighting, table.grid is not None)
    return usable(table, metric, fit.spec.select, anisotropic=anisotropic, weighting=weighting)


@dataclass(frozen=True)
class _Group:
    labels: list[str]
    uncertainty: FloatArray
    covariance: FloatArray
    #: Of each label the largest move by leaving one scan out, in its own uncertainties, and which scan.
    most: FloatArray
    which: IndexArray
    effective_samples: list[float]


def _group(
    places: Layout, fit: FitResult, data: Usable, rows: IndexArray, label: IndexArray, scans: int,
    group: Sequence[int], *, isotropic: bool,
) -> _Group:  # fmt: skip
    c, floor = len(group), data.floor[list(group)]
    p, labels = vector(places, fit, group)
    block = data.part(group, rows, max(CHUNK, padded(len(rows))))
    normal = normal_equations(places, data.metric, floor, p, [block])
    p, matrix, free = settled(places, p, normal, c)
    _, jacobian = (np.asarray(a) for a in to_natural(places, c, p))
    found = scan_sums(places, data.metric, floor, p, block, label, max(1, scans))
    where = np.flatnonzero(free)
    curvature, exact = free_curvature(found.slopes.sum(axis=0), matrix, where)
    jacobian = jacobian[:, where]

    q = len(labels)
    covariances: list[FloatArray] = []
    most, which = np.full(q, np.nan), np.zeros(q, np.intp)
    if scans:
        slopes = found.slopes[:, where][:, :, where]
        moves = _moves(found.scores[:, where], slopes, curvature, exact) @ jacobian.T
        moves = moves - moves.mean(axis=0)
        covariances.append((scans - 1) / scans * moves.T @ moves)
        u = np.sqrt(np.diagonal(covariances[0]))
        most, which = np.abs(moves).max(axis=0) / np.where(u > 0, u, np.nan), np.abs(moves).argmax(axis=0)
    field = correlated_outer(places, data.metric, floor, p, block, isotropic=isotropic)
    if scans < ENOUGH_SCANS:
        inverse = jacobian @ np.linalg.pinv(curvature, hermitian=True)
        covariances.append(inverse @ field.outer[np.ix_(where, where)] @ inverse.T)
    u = np.sqrt(np.maximum.reduce([np.diagonal(one) for one in covariances]))
    # Nothing is stated where the fit states nothing: on a bound, or not identified.
    stated = np.array([_stated(fit, name) for name in labels])
    covariance = covariances[0].copy()
    for k in np.flatnonzero(~stated):
        u[k] = most[k] = np.nan
        covariance[k, :] = covariance[:, k] = np.nan
    return _Group(labels, u, covariance, most, which, field.effective_samples)


def vector(places: Layout, fit: FitResult, group: Sequence[int]) -> tuple[FloatArray, list[str]]:
    """The solvers' vector p of a fit for the channels ``group``, and the labels (Q,) of the parameters in the
    order of :func:`fitter.fitting.covariance.to_natural`."""
    names = fit.model.channels
    labels = [_label(fit, p.name, names[k]) for p in places.linear for k in group]
    labels += [_label(fit, places.free[k], names[group[own or 0]]) for k, own in places.entries]
    values = {name: e.value for name, e in fit.parameters.items()}
    u = places.search_vector(values, group)
    linear = {p.name: jnp.asarray(np.atleast_1d(values[p.name])[list(group)]) for p in places.linear}
    if places.coefficients_are_free:
        nonlinear = places.nonlinear(jnp.asarray(u))
        rows = places.family.coefficients(places.spec, linear, nonlinear)
    else:
        rows = tuple(linear.values())
    inner = np.stack([np.broadcast_to(np.asarray(row), len(group)) for row in rows])
    return np.concatenate([u, inner.reshape(-1)]), labels


def _label(fit: FitResult, name: str, channel: str) -> str:
    own = f"{name}[{channel}]"
    return own if own in fit.labels else name


def _stated(fit: FitResult, label: str) -> bool:
    k = fit.labels.index(label)
    return bool(np.isfinite(fit.covariance[k, k]))


def free_curvature(exact: FloatArray, gauss_newton: FloatArray, where: IndexArray) -> tuple[FloatArray, bool]:
    """The exact curvature of what is free where it is safely convex, else Gauss-Newton's; and which."""
    plain = gauss_newton[np.ix_(where, where)]
    scale = np.sqrt(np.maximum(np.diagonal(plain), 1e-300))
    unit = np.outer(scale, scale)
    full = 0.5 * (exact + exact.T)[np.ix_(where, where)]
    if not np.isfinite(full).all():
        return plain, False
    values, vectors = np.linalg.eigh(plain / unit)
    known = values > 1e-10 * max(values.max(initial=0.0), 1e-300)
    root = vectors[:, known] / np.sqrt(values[known])
    relative = root.T @ (full / unit) @ root
    convex = bool(np.linalg.eigvalsh(relative).min(initial=1.0) > CONVEX)
    return (full, True) if convex else (plain, False)


def _moves(scores: FloatArray, slopes: FloatArray, curvature: FloatArray, exact: bool) -> FloatArray:
    """(G, F) by how much leaving a scan out moves the free entries: (H - H_g)^-1 s_g, or H^-1 s_g where its
    own share H_g of the curvature is not known."""
    scale = np.sqrt(np.maximum(np.diagonal(curvature), 1e-300))
    values, vectors = np.linalg.eigh(curvature / np.outer(scale, scale))
    known = values > 1e-10 * max(values.max(initial=0.0), 1e-300)
    # In these coordinates the whole curvature is the identity.
    turn = vectors[:, known] / np.sqrt(values[known]) / scale[:, None]
    moves = np.empty_like(scores)
    # A part of a table need not be at its own optimum.
    centred = scores - scores.mean(axis=0)
    for g, (score, slope) in enumerate(zip(centred, slopes, strict=True)):
        along = turn.T @ score
        if exact:
            left, axes = np.linalg.eigh(np.eye(turn.shape[1]) - turn.T @ (0.5 * (slope + slope.T)) @ turn)
            along = axes @ ((axes.T @ along) / np.maximum(left, LEAST_LEFT))
        moves[g] = turn @ along
    return moves
