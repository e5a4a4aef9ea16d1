"""Parameters: estimates, uncertainties by source, what is on a bound or not identified, correlations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.directions import vector_from_spherical
from fitter.models.base import SeparableModel
from fitter.models.pair import Pair
from fitter.report.clean import drawn
from fitter.report.fitted import Fitted, display, label_of
from fitter.report.rounding import NOT_STATED, at_place_of, rounded, significant
from fitter.student import coverage_factor, effective_degrees

if TYPE_CHECKING:
    from fitter.models.base import ReflectanceModel
    from fitter.posterior.result import Posterior

FloatArray = NDArray[np.float64]

#: Coverage probability of the expanded uncertainty U = k u: k = 2 where u has many degrees of freedom.
COVERAGE = 0.9545
LEVEL = 0.95
#: Parameters that a correlation matrix or a corner plot shows at most.
MOST_CORRELATED = 16
#: From this correlation on two parameters are not well told apart.
STRONG = 0.9
#: Strongest pairs that are looked at for words.
MOST_PAIRS = 200
#: Beyond this correlation, with a u beyond this share of an estimate, two are hardly separable.
HARDLY, BADLY = 0.99, 0.1
#: A standard uncertainty beyond this share of the estimate: the table barely determines the parameter.
BARELY = 0.5

MEANING = (
    "u belongs to the best-fitting parameter of this model over this range of angles; "
    "it is not a constant of the material."
)
KINDS = {
    "curvature": "curvature of the likelihood at the optimum, under the stated noise, independent from "
    "sample to sample",
    "sandwich": "curvature of the objective combined with the residuals as they are, taken as independent "
    "from sample to sample, for a metric that is not the likelihood",
}


def section(fitted: Fitted, posterior: Posterior | None) -> dict[str, Any]:
    """One row per parameter and channel, JSON-ready, with numbers and with text rounded for print."""
    fit = fitted.fit
    scale = fitted.table.metadata.scale_uncertainty
    return {
        "meaning": MEANING,
        "kind": fit.uncertainty,
        "kind_in_words": KINDS.get(fit.uncertainty, fit.uncertainty),
        "coverage_probability": COVERAGE,
        "credible_level": None if posterior is None else LEVEL,
        "scale_uncertainty": scale,
        "angle_uncertainty_deg": _degrees(fitted.table.metadata.angle_uncertainty),
        "rows": _rows(fitted, posterior, 0.0 if scale is None else scale),
        "noise_rows": [] if posterior is None else _noise_rows(fitted, posterior),
    }


def scale_sensitivity(model: ReflectanceModel) -> dict[str, FloatArray]:
    """d parameter / d ln(scale of the table) of each linear parameter, (C,); the others have none.

    A common factor of the table multiplies every coefficient; the model's own change of variables says
    what that does to its parameters (Schlick's F0 stays, ks takes the factor).
    """
    assert isinstance(model, SeparableModel)
    kind, spec, nonlinear = type(model), model.spec, model.nonlinear
    if not kind.coefficients_are_free(spec):
        return _nearest_sensitivity(model)
    coefficients = kind.coefficients(spec, model.linear, nonlinear)
    values, slopes = jax.jvp(
        lambda c: kind.linear_from(spec, c, nonlinear), (coefficients,), (coefficients,)
    )  # fmt: skip
    found: dict[str, FloatArray] = {}
    for name, slope in slopes.items():
        size, value = np.asarray(slope), np.abs(np.asarray(values[name]))
        # What is left of a derivative that cancels is rounding.
        found[name] = np.where(np.abs(size) > 1e-12 * np.maximum(value, 1e-300), size, 0.0)
    return found


def _nearest_sensitivity(model: SeparableModel) -> dict[str, FloatArray]:
    """:func:`scale_sensitivity` where no parameters multiply the values by a common factor: of those that
    come nearest, by least squares over a grid of directions, the nonlinear ones as they are."""
    theta, phi = np.deg2rad([0.0, 25.0, 50.0, 70.0]), np.deg2rad([0.0, 60.0, 120.0, 180.0])
    i, o, azimuth = (a.reshape(-1) for a in np.meshgrid(theta, theta, phi, indexing="ij"))
    wi, wo = vector_from_spherical(i, 0.0), vector_from_spherical(o, azimuth)
    linear = model.linear
    flat = jnp.stack([linear[name] for name in linear])

    def values(rows: Array) -> Array:
        changed = model.values | dict(zip(linear, rows, strict=True))
        return eqx.tree_at(lambda m: m.values, model, changed).value(Pair.split(wi, wo))

    slopes = np.asarray(jax.jacfwd(values)(flat))  # (n, C, L, C)
    here = np.asarray(values(flat))
    each = [np.linalg.lstsq(slopes[:, c, :, c], here[:, c], rcond=None)[0] for c in range(here.shape[1])]
    return {name: np.array([row[k] for row in each]) for k, name in enumerate(linear)}


def correlation(fitted: Fitted) -> dict[str, Any]:
    """The correlation matrix of the estimates and its strongest entries, in words too."""
    fit = fitted.fit
    deviation = np.sqrt(np.clip(np.diag(fit.covariance), 0.0, None)) if len(fit.labels) else np.empty(0)
    stated = np.flatnonzero(np.isfinite(deviation) & (deviation > 0))
    labels = [fit.labels[k] for k in stated]
    shown = [display(label, fit.model.channels) for label in labels]
    matrix = fit.covariance[np.ix_(stated, stated)] / np.outer(deviation[stated], deviation[stated])
    upper = np.triu_indices(len(labels), 1)
    values = matrix[upper]
    order = np.argsort(-np.abs(np.where(np.isfinite(values), values, 0.0)), kind="stable")
    order = order[np.isfinite(values[order])][:MOST_PAIRS]
    share = [deviation[k] / max(abs(fitted.estimates[fit.labels[k]]), 1e-300) for k in stated]
    pairs = [
        {"a": shown[i], "b": shown[j], "r": float(matrix[i, j])}
        for i, j in ((upper[0][k], upper[1][k]) for k in order)
    ]
    least_known = [max(share[upper[0][k]], share[upper[1][k]]) for k in order]
    words = [_in_words(pair, u) for pair, u in zip(pairs, least_known, strict=True)]
    keep = _shown(labels, fitted)
    return {
        "labels": [shown[k] for k in keep],
        "of": len(fit.labels),
        "matrix": drawn(matrix[np.ix_(keep, keep)]),
        "strongest": pairs[:6],
        "not_separable": [text for kind, text in words if kind == "not separable"][:4],
        "correlated": [text for kind, text in words if kind == "correlated"][:4],
    }


def _shown(labels: list[str], fitted: Fitted) -> list[int]:
    """Positions of shared parameters and of those of the channels that figures show."""
    channels = [fitted.fit.model.channels[c] for c in fitted.shown]
    keep: list[int] = []
    for k, label in enumerate(labels):
        name, bracket, _ = label.partition("[")
        if not bracket or any(label == label_of(name, c) for c in channels):
            keep.append(k)
    return keep[:MOST_CORRELATED]


def _in_words(pair: dict[str, Any], share: float) -> tuple[str, str]:
    """Kind of a correlation and what it means; one parameter in two channels merely moves together."""
    a, b, r = pair["a"], pair["b"], pair["r"]
    if abs(r) < STRONG or a.partition("[")[0] == b.partition("[")[0]:
        return "", ""
    kind = "sum" if r < 0 else "ratio"
    if abs(r) > HARDLY and share > BADLY:
        return "not separable", (
            f"{a} and {b} are hardly separable with this table (r = {r:.3f}): a combination like their "
            f"{kind} is determined far better than either."
        )
    return "correlated", (
        f"{a} and {b} are strongly correlated (r = {r:.2f}): a combination like their {kind} is better known."
    )


def _rows(fitted: Fitted, posterior: Posterior | None, scale: float) -> list[dict[str, Any]]:
    fit = fitted.fit
    declared = {p.name: p for p in fit.model.table}
    sensitivity = scale_sensitivity(fit.model)
    intervals = {} if posterior is None else posterior.intervals(LEVEL)
    rows: list[dict[str, Any]] = []
    for name, estimate in fit.parameters.items():
        values, u_fit = np.atleast_1d(estimate.value), np.atleast_1d(estimate.standard_uncertainty)
        own = np.atleast_1d(estimate.degrees_of_freedom)
        channels = fit.model.channels if estimate.value.ndim else (None,)
        slopes = np.broadcast_to(sensitivity.get(name, np.zeros(())), values.shape)
        bounds = fit.spec.bounds.get(name, declared[name].searched)
        for c, channel in enumerate(channels):
            label = label_of(name, channel)
            state = _state(name in fit.spec.fixed, estimate.at_bound[c], float(u_fit[c]))
            u_scale = float(abs(slopes[c]) * scale)
            u = float(np.hypot(u_fit[c], u_scale))
            degrees = effective_degrees(u * u, [(float(u_fit[c]) ** 2, float(own[c]))])
            k = float(coverage_factor(degrees, COVERAGE))
            text = rounded(float(values[c]), u)
            rows.append(
                {
                    "name": name, "channel": channel, "label": label,
                    "display": display(label, fit.model.channels), "unit": estimate.unit,
                    "description": estimate.description, "linear": declared[name].linear,
                    "lower": bounds[0], "upper": bounds[1], "prior": declared[name].prior,
                    "estimate": float(values[c]), "standard_uncertainty": u,
                    "effective_degrees_of_freedom": degrees, "coverage_factor": k,
                    "expanded_uncertainty": k * u,
                    "components": {"fit": float(u_fit[c]), "scale": u_scale},
                    "scale_sensitivity": float(slopes[c]),
                    "at_bound": estimate.at_bound[c], "state": state,
                    "barely_determined": bool(u > BARELY * abs(values[c])) if math.isfinite(u) else False,
                    "text": {
                        "estimate": text.value, "standard_uncertainty": text.uncertainty,
                        "expanded_uncertainty": _own(k * u, text.uncertainty),
                        "factor": NOT_STATED if text.uncertainty == NOT_STATED else significant(k, 3),
                        "fit": _own(float(u_fit[c]), text.uncertainty),
                        "scale": _own(u_scale, text.uncertainty) if u_scale > 0 else "0",
                    },
                    "posterior": _posterior_row(posterior, intervals, label),
                }
            )  # fmt: skip
    return rows


def _own(component: float, beside: str) -> str:
    """A component of u to two digits of its own; "—" where u itself is not stated."""
    return significant(component, 2) if beside != NOT_STATED or component > 0 else NOT_STATED


def _state(fixed: bool, at_bound: str | None, u: float) -> str:
    if fixed:
        return "fixed"
    if at_bound is not None:
        return f"on its {at_bound} bound"
    return "estimated" if math.isfinite(u) else "not identified"


def _posterior_row(
    posterior: Posterior | None, intervals: dict[str, dict[str, float]], label: str
) -> dict[str, Any] | None:
    if posterior is None or label not in intervals:
        return None
    row, diagnostic = intervals[label], posterior.diagnostics.get(label)
    return {
        **row,
        "rhat": None if diagnostic is None else diagnostic.rhat,
        "ess_bulk": None if diagnostic is None else diagnostic.ess_bulk,
        "ess_tail": None if diagnostic is None else diagnostic.ess_tail,
        "text": {
            "median": at_place_of(row["median"], row["sd"]),
            "lower": at_place_of(row["lower"], row["sd"]),
            "upper": at_place_of(row["upper"], row["sd"]),
        },
    }


def _noise_rows(fitted: Fitted, posterior: Posterior) -> list[dict[str, Any]]:
    """Parameters of the likelihood that are not the model's: relative noise and noise floor."""
    known = set(fitted.fit.parameters)
    intervals = posterior.intervals(LEVEL)
    return [
        {
            "label": label,
            "display": display(label, fitted.fit.model.channels),
            "posterior": _posterior_row(posterior, intervals, label),
        }
        for label in posterior.labels
        if label.partition("[")[0] not in known
    ]


def _degrees(radians: float | None) -> float | None:
    return None if radians is None else float(np.rad2deg(radians))
