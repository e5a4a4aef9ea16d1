"""Metrics: what "close" means. Each is a transform T and a weight, named, apart from models and solvers.

The objective is the sum over usable samples and channels of w^2 (T(s f) - T(s y))^2, f the model, y the
measurement:

    measurement  w = 1/u(y)      T(x) = x          the likelihood where the table states its noise
    absolute     w = 1           T(x) = x          plain least squares in 1/sr
    cosine       w = 1, s = cos_i, T(x) = x        error of the reflected radiance (Ngan et al. 2005's L2
                                                   without the solid-angle weights)
    log          w = 1           T(x) = ln(x + e)  relative error; e = 1e-3 of the median value
    cbrt         w = 1, s = cos_i, T(x) = x^(1/3)  between them, near what the eye sees (Fores et al. 2012)

Where a table states no noise the default is cbrt. Weighted least squares follows the few brightest samples:
Sun, Jensen and Ramamoorthi 2018 found one-lobe fits of 100 materials to render at 28.8 dB with it, at
39.4 dB with a logarithm and at 41.3 dB with the cube root; and with noise in proportion to the value it
leaves the diffuse albedo to chance (0.6 % on a MERL table with 1 % noise, where cbrt has 0.01 %).
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.spec import Metric

FloatArray = NDArray[np.float64]
#: Share of the median value that is added under the logarithm, and below which a slope is not followed.
LOG_FLOOR = 1e-3
QUADRATIC: frozenset[str] = frozenset({"measurement", "absolute", "cosine"})


def default(sigma_is_stated: bool) -> Metric:
    """The metric of a fit that asks for none."""
    return "measurement" if sigma_is_stated else "cbrt"


def scaling(metric: Metric, scale: FloatArray) -> FloatArray:
    """By what a weight is multiplied so that squared residuals are multiplied by ``scale``.

    The cube root is taken after the weight.
    """
    return scale**1.5 if metric == "cbrt" else np.sqrt(scale)


class Residual(NamedTuple):
    """T(s f) - T(s y) and its slope in f, each of the shape of f."""

    value: Array
    slope: Array


def base_weights(
    metric: Metric, value: FloatArray, sigma: FloatArray | None, cos_i: FloatArray
) -> FloatArray:
    """(n, C) w s of each value, or (n, 1) where the channels have the same: all that does not depend on the
    model."""
    if metric == "measurement":
        if sigma is None:
            raise SpecError(
                "the metric 'measurement' weights by 1/u, and the table states no standard uncertainty",
                code="metric-needs-sigma", parameter="metric",
                remedy="give sigma with the table, or use cosine, absolute, log or cbrt",
            )  # fmt: skip
        return 1.0 / sigma
    if metric in ("cosine", "cbrt"):
        return cos_i[:, None].copy()
    return np.ones((len(value), 1))


def target(metric: Metric, y: FloatArray, weight: FloatArray, floor: FloatArray) -> FloatArray:
    """What the residual subtracts, (n, C): y itself where T is the identity, else w T(s y)."""
    if metric in QUADRATIC:
        return y
    if metric == "log":
        # Below -floor a value has no logarithm; the engine leaves such samples out and says so.
        return weight * np.log(np.maximum(y + floor, 1e-300))
    return np.cbrt(weight * y)


def residual(metric: Metric, f: Array, goal: Array, weight: Array, floor: Array) -> Residual:
    """The residual of a metric. ``goal`` is :func:`target` of the measurements, ``floor`` the value scale
    per channel, LOG_FLOOR x median."""
    if metric in QUADRATIC:
        return Residual(weight * (f - goal), jnp.broadcast_to(weight, jnp.shape(f)))
    if metric == "log":
        shifted = jnp.maximum(f, 0.0) + floor
        return Residual(weight * jnp.log(shifted) - goal, weight / shifted)
    # The cube root's slope is infinite at 0: follow it no closer to 0 than the floor. Only the path to
    # the optimum depends on this, the objective does not.
    root = jnp.cbrt(weight * f)
    return Residual(root - goal, weight / (3.0 * jnp.maximum(root * root, jnp.square(jnp.cbrt(floor)))))


@functools.partial(jax.jit, static_argnames="metric")
def linearised_weight(metric: Metric, y: Array, weight: Array, floor: Array) -> Array:
    """Weight of the quadratic objective that the metric is near its optimum: the slope at f = y."""
    if metric in QUADRATIC:
        return weight
    return residual(metric, jnp.maximum(y, floor), jnp.zeros_like(y), weight, floor).slope
