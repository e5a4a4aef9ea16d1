"""The uncertainty budget: for every parameter what each source contributes, and what that makes together.

GUM (JCGM 100:2008): sensitivity coefficients 5.1.3, combined standard uncertainty 5.1.2, effective degrees
of freedom by Welch and Satterthwaite G.4.1, U = k u with k of Student's t.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fitter.models.labelled import place
from fitter.report.fitted import Fitted, display
from fitter.report.parameters import scale_sensitivity
from fitter.report.rounding import at_place_of, rounded, significant
from fitter.student import coverage_factor, effective_degrees

if TYPE_CHECKING:
    from fitter.posterior.jackknife import Robust

FloatArray = NDArray[np.float64]
LEVEL = 0.95
OFFSETS = ("theta_i", "theta_o", "phi")
WORDS = {
    "noise": "spread of the measured values, independent from sample to sample",
    "scale": "the reference standard's scale, common to the table",
    "theta_i": "offset of the incidence angle θ_i, common to the table",
    "theta_o": "offset of the viewing angle θ_o, common to the table",
    "phi": "offset of the azimuth between the two, common to the table",
    "discrepancy": "misfit of the model, as the robust uncertainty finds it beyond the noise",
}


@dataclass(frozen=True)
class Budget:
    """labels : (Q,) of the free parameters. parts : by source, (Q, Q) covariances; of a source that is not
    stated None. section : JSON-ready."""

    labels: tuple[str, ...]
    parts: Mapping[str, FloatArray | None]
    section: dict[str, Any]

    @property
    def covariance(self) -> FloatArray:
        """(Q, Q) of all sources that are stated; NaN in rows without a stated uncertainty."""
        known = [part for part in self.parts.values() if part is not None]
        return np.sum(known, axis=0) if known else np.zeros((len(self.labels),) * 2)


def budget(fitted: Fitted, robust: Robust | None, offsets: Mapping[str, FloatArray] | None) -> Budget:
    """The budget of a fit. robust, offsets : :func:`fitter.posterior.robust` and
    :func:`fitter.posterior.sensitivity.offset_sensitivities`, or None."""
    fit, meta = fitted.fit, fitted.table.metadata
    labels, q = fit.labels, len(fit.labels)
    noise = np.asarray(fit.covariance, np.float64)
    scale = _scale(fitted)
    angle = None if offsets is None else np.array([offsets[label] for label in labels]).reshape(q, 3)
    parts: dict[str, FloatArray | None] = {"noise": noise}
    slopes: dict[str, FloatArray] = {"scale": scale}
    stated = {"scale": meta.scale_uncertainty}
    for k, name in enumerate(OFFSETS):
        stated[name] = meta.angle_uncertainty
        if angle is not None:
            slopes[name] = angle[:, k]
    for name, u in stated.items():
        known = u is not None and name in slopes
        parts[name] = np.outer(slopes[name], slopes[name]) * float(u) ** 2 if known and u else None
    parts["discrepancy"] = None if robust is None else _discrepancy(noise, robust)
    freedom = {
        # One value of each sample and channel, less the free parameters; a parameter may be told by fewer.
        "noise": float(max(1, len(fitted.index) * len(fitted.columns) - q)),
        "discrepancy": math.inf if robust is None else robust.degrees_of_freedom,
    }
    own = _degrees(fitted)
    rows = [
        _row(fitted, k, label, parts, slopes, freedom | {"noise": min(freedom["noise"], own[label])})
        for k, label in enumerate(labels)
    ]
    found = Budget(labels, parts, {})
    section = {
        "level": LEVEL,
        "sources": [
            {
                "source": name, "type": "A" if name in ("noise", "discrepancy") else "B",
                "words": WORDS[name], "stated": parts[name] is not None,
                "standard_uncertainty": _own_unit(name, stated.get(name)),
                "unit": "%" if name == "scale" else "deg" if name in OFFSETS else None,
                "degrees_of_freedom": freedom.get(name, math.inf),
            }
            for name in parts
        ],
        "rows": rows,
        "covariance": {"labels": list(labels), "matrix": found.covariance},
        "joint": _joint(fitted, found.covariance),
    }  # fmt: skip
    return Budget(labels, parts, section)


def _own_unit(name: str, u: float | None) -> float | None:
    if u is None:
        return None
    return 100.0 * u if name == "scale" else float(np.rad2deg(u))


def _degrees(fitted: Fitted) -> dict[str, float]:
    """Of the fit's u of each label; infinite where it states none."""
    channels = fitted.fit.model.channels
    found: dict[str, float] = {}
    for label in fitted.fit.labels:
        name, where = place(label, channels)
        degrees = float(np.atleast_1d(fitted.fit.parameters[name].degrees_of_freedom)[where or 0])
        found[label] = degrees if math.isfinite(degrees) else math.inf
    return found


def _scale(fitted: Fitted) -> FloatArray:
    """(Q,) d estimate / d ln(scale)."""
    found = scale_sensitivity(fitted.fit.model)
    channels = fitted.fit.model.channels
    rows: list[float] = []
    for label in fitted.fit.labels:
        name, where = place(label, channels)
        slope = np.atleast_1d(found.get(name, np.zeros(1)))
        rows.append(float(slope[where or 0] if len(slope) > 1 else slope[0]))
    return np.array(rows)


def _discrepancy(noise: FloatArray, robust: Robust) -> FloatArray:
    """The robust variances less those of the noise, not below 0, correlated as the robust ones are."""
    u = np.array([robust.standard_uncertainty[label] for label in robust.labels])
    rest = np.sqrt(np.maximum(np.square(u) - np.diagonal(noise), 0.0))
    for matrix in (robust.covariance, noise):
        own = np.sqrt(np.diagonal(matrix))
        correlation = matrix / np.where(own > 0, np.outer(own, own), np.nan)
        # Between channels that are fitted apart none is stated: they are taken as independent.
        correlation = np.where(np.isfinite(correlation), correlation, np.eye(len(u)))
        if np.linalg.eigvalsh(correlation).min(initial=0.0) > -1e-8:
            return np.outer(rest, rest) * correlation
    return np.diag(np.square(rest))


def _row(
    fitted: Fitted, k: int, label: str, parts: Mapping[str, FloatArray | None],
    slopes: Mapping[str, FloatArray], freedom: Mapping[str, float],
) -> dict[str, Any]:  # fmt: skip
    y = fitted.estimates[label]
    variances = {name: None if part is None else float(part[k, k]) for name, part in parts.items()}
    known = [v for v in variances.values() if v is not None]
    u = math.sqrt(max(0.0, sum(known))) if np.isfinite(known).all() else math.nan
    whole = effective_degrees(
        u * u, [(v, freedom[name]) for name, v in variances.items() if v and name in freedom]
    )
    factor = float(coverage_factor(whole, LEVEL))
    text = rounded(y, u)
    return {
        "label": label, "display": display(label, fitted.fit.model.channels),
        "unit": fitted.fit.parameters[label.partition("[")[0]].unit, "estimate": y,
        "components": {
            name: {
                "standard_uncertainty": None if v is None else math.sqrt(max(v, 0.0)) if v == v else math.nan,
                "sensitivity": _sensitivity(name, slopes, k),
                "text": "not stated" if v is None else significant(math.sqrt(v), 2) if v > 0 else
                "0" if v == 0 else "—",
            }
            for name, v in variances.items()
        },
        "combined": u, "effective_degrees_of_freedom": whole, "coverage_factor": factor,
        "expanded": factor * u, "lower": y - factor * u, "upper": y + factor * u,
        "interval": f"coverage interval, {100 * LEVEL:g} %, Student's t",
        "text": {
            "estimate": text.value, "combined": text.uncertainty, "expanded": significant(factor * u, 2),
            "factor": significant(factor, 3), "freedom": f"{whole:.0f}" if math.isfinite(whole) else "∞",
            "lower": at_place_of(y - factor * u, u), "upper": at_place_of(y + factor * u, u),
        },
    }  # fmt: skip


def _sensitivity(name: str, slopes: Mapping[str, FloatArray], k: int) -> float | None:
    """Per percent of the scale, per degree of an angle."""
    if name not in slopes:
        return None
    slope = float(slopes[name][k])
    return 0.01 * slope if name == "scale" else float(np.deg2rad(slope))


def _joint(fitted: Fitted, covariance: FloatArray) -> dict[str, Any] | None:
    """The joint 95 % region of all parameters, and the ellipse of the two that are most correlated."""
    u = np.sqrt(np.diagonal(covariance))
    stated = np.flatnonzero(np.isfinite(u) & (u > 0))
    if len(stated) < 2:
        return None
    matrix = covariance[np.ix_(stated, stated)]
    unit = matrix / np.outer(u[stated], u[stated])
    i, j = np.unravel_index(np.argmax(np.abs(np.triu(np.nan_to_num(unit), 1))), unit.shape)
    a, b = stated[i], stated[j]
    pair = covariance[np.ix_([a, b], [a, b])]
    radius = math.sqrt(float(stats.chi2.ppf(LEVEL, 2)))
    # In units of the two u, where the ellipse of a correlation r has axes sqrt(1 +- r) along the diagonals.
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    scaled = np.linalg.cholesky(pair / np.outer(u[[a, b]], u[[a, b]]) + 1e-12 * np.eye(2))
    ring = (radius * scaled @ np.stack([np.cos(angle), np.sin(angle)])) * u[[a, b]][:, None]
    labels = [fitted.fit.labels[k] for k in (a, b)]
    return {
        "parameters": len(stated), "level": LEVEL,
        "mahalanobis_radius": math.sqrt(float(stats.chi2.ppf(LEVEL, len(stated)))),
        "a": display(labels[0], fitted.fit.model.channels),
        "b": display(labels[1], fitted.fit.model.channels),
        "correlation": float(unit[i, j]), "radius": radius,
        "centre": [fitted.estimates[label] for label in labels], "u": u[[a, b]],
        "ellipse": [ring[0] + fitted.estimates[labels[0]], ring[1] + fitted.estimates[labels[1]]],
    }  # fmt: skip
