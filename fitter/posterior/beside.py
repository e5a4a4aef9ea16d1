"""What stands beside a posterior: its own spread, the naive and the robust uncertainty, each by its name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import models
from fitter.posterior.ensembles import Ensembles
from fitter.posterior.jackknife import Robust

FloatArray = NDArray[np.float64]
REFERS_TO = (
    "the best-fitting parameter of this model over this range of angles; it is not a constant of the material"
)
NAIVE = "curvature of the likelihood under independent Gaussian noise, and angles that are exactly as stated"


def naive(runs: Sequence[Ensembles]) -> dict[str, float]:
    """Standard uncertainties by label from the curvature at the mode (Laplace), in the parameters' units."""
    found: dict[str, float] = {}
    for run in runs:
        mode, covariance = run.proposal[:2]
        # d exp(y) = exp(y) dy, and d (y unit) = unit dy
        slope = np.where(run.logs, np.exp(np.where(run.logs, mode, 0.0)), run.units)
        found |= dict(zip(run.labels, np.abs(slope) * np.sqrt(np.diagonal(covariance)), strict=True))
    return {label: float(u) for label, u in found.items()}


def beside(
    labels: Sequence[str], draws: FloatArray, words: str, plain: Mapping[str, float] | None,
    robust: Robust | None,
) -> dict[str, Any]:
    """JSON-ready: of each of the three what it is, in words, and u by label; None where none is stated.

    draws : of the posterior (S, P), not rescaled. plain : of :func:`naive`, None where the posterior's own
    likelihood is the naive one. robust : None where it was not asked for.
    """
    sd = draws.std(axis=0, ddof=1)
    return {
        "refers_to": REFERS_TO,
        "posterior": {
            "words": words, "u": {label: float(u) for label, u in zip(labels, sd, strict=True)}
        },
        "naive": None if plain is None else {"words": NAIVE, "u": dict(plain)},
        "robust": None if robust is None else {
            "words": _words(robust),
            "u": {k: u if math.isfinite(u) else None for k, u in robust.standard_uncertainty.items()},
            "method": robust.method, "scans": robust.scans, "coverage_factor": robust.coverage_factor,
            "effective_samples": list(robust.effective_samples),
        },
    }  # fmt: skip


def _words(robust: Robust) -> str:
    if not robust.scans:
        return "residuals as correlated over directions as these; there are no scans to leave out"
    left = f"the spread of the estimates when one of {robust.scans} scans after the other is left out"
    if robust.method == "larger":
        return f"the larger of {left}, and of what residuals as correlated as these do"
    return left


def rescaled(
    draws: FloatArray, labels: Sequence[str], template: models.ReflectanceModel, robust: Robust,
    rng: np.random.Generator,
) -> FloatArray:  # fmt: skip
    """Draws (S, P) with their centre and the robust covariance, Student's t where its degrees of freedom are
    few. Parameters without a robust uncertainty keep their draws; none leaves its range.

    Of fewer scans than parameters the covariance has no width along some directions: no direction gets
    narrower than it was then.
    """
    stated = robust.standard_uncertainty
    known = [k for k, label in enumerate(labels) if math.isfinite(stated.get(label, math.nan))]
    if not known:
        return draws
    where = [robust.labels.index(labels[k]) for k in known]
    target = np.nan_to_num(robust.covariance[np.ix_(where, where)])
    u = np.array([stated[labels[k]] for k in known])
    # Where scans are few, u is the larger of two: the correlations are the jackknife's.
    factor = u / np.sqrt(np.diagonal(target))
    mean = draws[:, known].mean(axis=0)
    own = np.cov(draws[:, known].T).reshape(len(known), -1)
    root, inverse = _roots(own)
    values, vectors = np.linalg.eigh(inverse @ (target * np.outer(factor, factor)) @ inverse.T)
    least = 1.0 if robust.scans and robust.scans <= len(known) else 0.0
    stretch = (vectors * np.sqrt(np.maximum(values, least))) @ vectors.T
    moved = (draws[:, known] - mean) @ (root @ stretch @ inverse).T
    if math.isfinite(robust.degrees_of_freedom):
        freedom = robust.degrees_of_freedom
        moved *= np.sqrt(freedom / rng.chisquare(freedom, size=(len(draws), 1)))
    found = draws.copy()
    found[:, known] = mean + moved
    declared = {p.name: p for p in template.table}
    for k in known:
        p = declared[labels[k].partition("[")[0]]
        # Mirrored at a bound, as the sampler folds it.
        inside = p.lower + np.abs(found[:, k] - p.lower) if math.isfinite(p.lower) else found[:, k]
        found[:, k] = np.minimum(inside, p.upper)
    return found


def _roots(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A root L (L L^T is the matrix) and its inverse, in units of the standard deviations."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    values = np.maximum(values, 1e-12)
    return scale[:, None] * vectors * np.sqrt(values), (vectors / np.sqrt(values)).T / scale
