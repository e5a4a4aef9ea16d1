"""What the uncertainty of the parameters does to the BRDF and the reflectance: GUM's linear propagation
beside a Monte Carlo one (JCGM 101:2008 for one quantity, JCGM 102:2011 for parameters that vary together).

Linear: u(f)^2 = g V g^T with the exact derivative g. Monte Carlo: draws from the normal with covariance V,
reflected into the bounds, through the model as it is. For the parameters themselves the draws are those of
the posterior, which know how the estimates follow from the noise; they are held against the noise's part.
Linear propagation is validated where the ends of both 95 % intervals differ by less than the numerical
tolerance delta of u to one digit (JCGM 101, 7.9.2 and 8.1). Both intervals are taken from the same draws, and
the ends of the linear one corrected by what is known of them exactly, so that the draws' own noise cancels.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy import special

from fitter import directions
from fitter.fitting.blocks import padded
from fitter.models.albedo import quadrature
from fitter.models.labelled import with_values
from fitter.models.padded import evaluated
from fitter.posterior.predictive import slopes
from fitter.report.budget import Budget
from fitter.report.fitted import Fitted, display

if TYPE_CHECKING:
    from fitter.models.base import ReflectanceModel
    from fitter.posterior.result import Posterior

FloatArray = NDArray[np.float64]
LEVEL = 0.95
#: Draws of the parameters: what they have in common with the linear propagation cancels.
DRAWS = 400
#: Directions that stand for the hemisphere where only changes of the reflectance are asked for.
NODES = 1_024
#: Viewing angles of a slice (degrees, positive on the specular side) beside the specular one.
VIEWERS = (-60.0, -30.0, 0.0, 30.0, 60.0)
INCIDENCES_DEG = (0.0, 45.0, 70.0)


def section(fitted: Fitted, budget: Budget, posterior: Posterior | None, seed: int) -> dict[str, Any]:
    """JSON-ready: rows of the BRDF on slices, of the reflectance and, with a posterior, the parameters."""
    model, channels = fitted.fit.model, fitted.fit.model.channels
    known = np.flatnonzero(np.isfinite(np.diagonal(budget.covariance)))
    if not len(known):
        return {"draws": 0, "sources": [], "brdf": [], "reflectance": [], "parameters": [], "validated": None}
    labels = [budget.labels[k] for k in known]
    values, vectors = np.linalg.eigh(budget.covariance[np.ix_(known, known)])
    z = np.random.default_rng([seed, 2]).standard_normal((DRAWS, len(known)))
    centre = np.array([fitted.estimates[label] for label in labels])
    rows = centre + z @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    drawn = with_values(model, labels, _reflected(fitted, labels, rows))

    # One call for all directions: of slices, and of the hemispheres that reflectances are integrated over.
    theta_i, theta_o = _angles(fitted)
    incidences = directions.vector_from_spherical(np.deg2rad(INCIDENCES_DEG), 0.0)
    nodes = [_nodes(model, one) for one in incidences]
    wi = np.concatenate([
        directions.vector_from_spherical(np.deg2rad(theta_i), 0.0), np.repeat(incidences, NODES, axis=0)
    ])  # fmt: skip
    wo = np.concatenate([
        directions.vector_from_spherical(np.deg2rad(theta_o), np.pi), *(one for one, _ in nodes)
    ])  # fmt: skip
    here = evaluated(model, wi, wo)
    # The columns of slopes are the principal directions, in the order of eigh.
    linear = slopes(model, budget.labels, budget.covariance, wi, wo)
    extra = padded(len(wi)) - len(wi)
    f = np.asarray(_each(drawn, *(np.pad(w, ((0, extra), (0, 0)), mode="edge") for w in (wi, wo))))
    m = len(theta_i)
    straight = here[:m] + np.einsum("sq,mqc->smc", z, linear[:m])
    u = np.sqrt(np.square(linear[:m]).sum(axis=1))
    brdf = [
        {
            "theta_i_deg": float(theta_i[k]), "theta_o_deg": float(theta_o[k]), "channel": channels[c],
            **_compared(here[k, c], u[k, c], f[:, k, c], straight[:, k, c]),
        }
        for k in range(m) for c in fitted.shown
    ]  # fmt: skip
    reflectance: list[dict[str, Any]] = []
    for k, (degrees, (_, weight)) in enumerate(zip(INCIDENCES_DEG, nodes, strict=True)):
        part = slice(m + k * NODES, m + (k + 1) * NODES)
        total = np.asarray(model.albedo(incidences[k]))
        own = weight @ here[part]
        # The nodes give what changes; how much there is to change comes from the whole quadrature.
        unit = total / np.where(own > 0, own, 1.0)
        slope = np.einsum("m,mqc->qc", weight, linear[part]) * unit
        through = np.einsum("m,smc->sc", weight, f[:, part]) * unit
        spread, flat = np.sqrt(np.square(slope).sum(axis=0)), total + z @ slope
        reflectance += [
            {
                "theta_i_deg": degrees, "channel": channels[c],
                **_compared(total[c], spread[c], through[:, c], flat[:, c]),
            }
            for c in fitted.shown
        ]  # fmt: skip
    parameters = [] if posterior is None else _parameters(fitted, posterior)
    return {
        "level": LEVEL, "draws": DRAWS, "seed": seed,
        "sources": [name for name, part in budget.parts.items() if part is not None],
        "brdf": brdf, "reflectance": reflectance, "parameters": parameters,
        "validated": _share([*brdf, *reflectance]),
    }  # fmt: skip


def tolerance(u: float) -> float:
    """delta: half of the last digit of u where one digit of it is meant (JCGM 101, 7.9.2)."""
    return 0.5 * 10.0 ** math.floor(math.log10(u)) if u > 0 and math.isfinite(u) else math.nan


def _compared(y: float, u: float, drawn: FloatArray, straight: FloatArray) -> dict[str, Any]:
    """One quantity: linear and Monte Carlo, from the same draws."""
    tail = [0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL)]
    k = float(special.ndtri(tail[1]))
    away = np.quantile(drawn, tail) - np.quantile(straight, tail)
    spread = float(straight.std())
    mc = u * float(drawn.std()) / spread if spread > 0 else float(drawn.std())
    delta = tolerance(u)
    return {
        "estimate": float(y), "linear": float(u), "monte_carlo": float(mc),
        "linear_interval": [float(y - k * u), float(y + k * u)],
        "monte_carlo_interval": [float(y - k * u + away[0]), float(y + k * u + away[1])],
        "delta": delta, "validated": bool(np.abs(away).max() <= delta),
    }  # fmt: skip


def _angles(fitted: Fitted) -> tuple[FloatArray, FloatArray]:
    """Angles (M,) in degrees: measured incidences, and the specular direction among the viewers."""
    low, high = (float(np.rad2deg(a)) for a in fitted.table.domain.theta_i)
    incidences = np.unique(np.round(np.linspace(low, min(high, 75.0), 3), 1))
    pairs = [(i, o) for i in incidences for o in sorted({*VIEWERS, float(i)})]
    theta_i, theta_o = np.array(pairs, np.float64).T
    return theta_i, theta_o


def _nodes(model: ReflectanceModel, wi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Directions (M, 3) and weights (M,) that integrate over the hemisphere what differs little from the
    model: nodes of its quadrature, picked evenly along its own integral."""
    wo, weight = (np.asarray(a) for a in quadrature(jnp.asarray(wi), whole=True))
    f = evaluated(model, np.broadcast_to(wi, wo.shape), wo).clip(0.0).sum(axis=1) * weight
    total = np.cumsum(f)
    if not total[-1] > 0:
        f, total = weight, np.cumsum(weight)
    picked = np.searchsorted(total, (np.arange(NODES) + 0.5) / NODES * total[-1])
    return wo[picked], weight[picked] * total[-1] / (NODES * f[picked])


def _parameters(fitted: Fitted, posterior: Posterior) -> list[dict[str, Any]]:
    """The noise's part of u beside the posterior's spread."""
    rows: list[dict[str, Any]] = []
    k = float(special.ndtri(0.5 * (1.0 + LEVEL)))
    for j, label in enumerate(fitted.fit.labels):
        if label not in posterior.labels:
            continue
        y, u = fitted.estimates[label], float(np.sqrt(fitted.fit.covariance[j, j]))
        draws = posterior.draws[:, posterior.labels.index(label)]
        low, high = np.quantile(draws, [0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL)])
        delta = tolerance(u)
        away = max(abs(low - (y - k * u)), abs(high - (y + k * u)))
        rows.append({
            "label": label, "display": display(label, fitted.fit.model.channels), "estimate": y, "linear": u,
            "monte_carlo": float(draws.std(ddof=1)), "linear_interval": [y - k * u, y + k * u],
            "monte_carlo_interval": [float(low), float(high)], "delta": delta,
            "validated": bool(away <= delta),
        })  # fmt: skip
    return rows


def _share(rows: list[dict[str, Any]]) -> float:
    return sum(row["validated"] for row in rows) / len(rows) if rows else math.nan


def _reflected(fitted: Fitted, labels: list[str], rows: FloatArray) -> FloatArray:
    """Draws (S, Q) beyond a bound, mirrored back inside."""
    declared = {p.name: p for p in fitted.fit.model.table}
    ends = [declared[label.partition("[")[0]] for label in labels]
    low, high = np.array([p.lower for p in ends]), np.array([p.upper for p in ends])
    rows = np.where(rows < low, 2.0 * low - rows, rows)
    rows = np.where(rows > high, 2.0 * high - rows, rows)
    return np.clip(rows, low, high)


@eqx.filter_jit
def _each(models: ReflectanceModel, wi: FloatArray, wo: FloatArray) -> jax.Array:
    return jax.lax.map(lambda one: one.evaluate(wi, wo), models)
