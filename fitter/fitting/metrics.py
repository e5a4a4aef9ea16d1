"""Metrics: what "close" means. Each is a residual and a weight, named, apart from models and solvers.

The objective is the sum over usable samples and channels of w^2 (T(s f) - T(s y))^2, f the model, y the
measurement:

    measurement  w = 1/u(y)      T(x) = x          the likelihood where the table states its noise
    absolute     w = 1           T(x) = x          plain least squares in 1/sr
    cosine       w = 1, s = cos_i, T(x) = x        error of the reflected radiance (Ngan et al. 2005's L2,
                                                   which has solid-angle weights besides)
    relative     the deviance of noise in proportion to f + e: below
    log          w = 1           T(x) = ln(x + e)  relative error; e = 1e-3 of the median value
    cbrt         w = 1, s = cos_i, T(x) = x^(1/3)  between them, near what the eye sees (Fores et al. 2012);
                                                   for |x| < e the cubic that continues it, see _root

``relative`` is not (f - y)/y: weights that are taken from noisy values favour those that came out too small
and bias the albedos by minus twice the relative variance. Weights 1/(f + e) of the model, iterated, do not;
what they converge to is the optimum of the gamma family's deviance, 2 (t - 1 - ln t) with t = (y + e)/(f + e)
(Wedderburn 1974, McCullagh and Nelder 1989), which is (f - y)^2/f^2 for small differences and needs no
iteration. The logarithm has a quarter of that bias.

With the weighting "solid_angle" (:mod:`fitter.fitting.measures`) squared residuals are multiplied by the
solid angles that samples stand for, their mean being 1. It is the default on grids, whose spacing is the file
format's and not the surface's, but for ``measurement``, whose weights are the noise, and ``absolute``, which
is to be plain. A surface (GGX, alpha 0.25) that the model (Ward) can't follow has ks 2.4 times larger on
MERL's grid than on one in theta_i and theta_o under cbrt without it, and 0.2 % larger with it; and its albedo
at 30 deg on MERL's grid is 79 % off without (alpha 0.1) and 42 % with it.

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
from fitter.fitting import aligned, cube_root
from fitter.spec import Metric, Weighting

FloatArray = NDArray[np.float64]
#: Share of the median value that is added under the logarithm, and below which the cube root is a polynomial.
LOG_FLOOR = 1e-3
QUADRATIC: frozenset[str] = frozenset({"measurement", "absolute", "cosine"})
#: Metrics that only exist above -e.
POSITIVE: frozenset[str] = frozenset({"relative", "log"})
#: Relative differences below which the deviance is its series.
SMALL = 1e-2


def default(sigma_is_stated: bool) -> Metric:
    """The metric of a fit that asks for none."""
    return "measurement" if sigma_is_stated else "cbrt"


class Residual(NamedTuple):
    """T(s f) - T(s y) and its slope in f, each of the shape of f."""

    value: Array
    slope: Array


def weighting(metric: Metric, given: Weighting | None, grid: bool) -> Weighting:
    """The weighting of a fit that asks for ``given``, of a table on a grid or not."""
    if given is not None:
        return given
    return "solid_angle" if grid and metric not in ("measurement", "absolute") else "samples"


def base_weights(
    metric: Metric, sigma: FloatArray | None, cos_i: FloatArray, measure: FloatArray | None = None
) -> FloatArray:
    """(C, n) w T(s)/T(1) of each value, or (1, n) where the channels have the same: all that does not depend
    on the model.

    sigma : (C, n) standard uncertainties. measure : (n,) what multiplies the squared residuals, None for 1.
    """
    factor = aligned.empty(cos_i.shape)
    factor[...] = 1.0 if measure is None else np.sqrt(measure)
    if metric == "measurement":
        if sigma is None:
            raise SpecError(
                "the metric 'measurement' weights by 1/u, and the table states no standard uncertainty",
                code="metric-needs-sigma", parameter="metric",
                remedy="give sigma with the table, or use cosine, absolute, relative, log or cbrt",
            )  # fmt: skip
        return np.divide(factor, sigma, out=aligned.empty(sigma.shape))
    if metric == "cosine":
        factor *= cos_i
    if metric == "cbrt":
        factor *= np.cbrt(cos_i)
    return factor[None]


def target(metric: Metric, y: Array, weight: Array, floor: Array) -> Array:
    """w T(s y), what the residual is the distance from; y + e for the deviance.

    Below -e a value has no logarithm; the engine leaves such samples out and says so.
    """
    if metric in QUADRATIC:
        return weight * y
    if metric in POSITIVE:
        shifted = jnp.maximum(y + floor, 1e-300)
        return shifted if metric == "relative" else weight * jnp.log(shifted)
    return weight * jnp.cbrt(floor) * _root(y / floor)[0]


def residual(metric: Metric, f: Array, y: Array, weight: Array, floor: Array) -> Residual:
    """The residual of values f from measurements y of their shape. ``floor`` is the value scale per channel,
    LOG_FLOOR x median."""
    if metric in QUADRATIC:
        return Residual(weight * (f - y), jnp.broadcast_to(weight, jnp.shape(f)))
    goal = target(metric, y, weight, floor)
    if metric == "log":
        shifted = jnp.maximum(f, 0.0) + floor
        return Residual(weight * jnp.log(shifted) - goal, weight / shifted)
    if metric == "relative":
        return _deviance(jnp.maximum(f, 0.0) + floor, goal, weight)
    root, slope = _root(f / floor)
    scale = weight * jnp.cbrt(floor)
    return Residual(scale * root - goal, scale / floor * slope)


def _root(t: Array) -> tuple[Array, Array]:
    """The cube root of t and its slope, and for |t| < 1 those of the odd cubic that joins it there: the slope
    of the root is infinite at 0, and with another one than the objective's passes end beside the optimum."""
    size = jnp.abs(t)
    inside = size < 1.0
    inverse = cube_root.inverse(jnp.where(inside, 1.0, size))
    square = jnp.square(inverse)
    return (
        t * jnp.where(inside, (4.0 - t * t) / 3.0, square),
        jnp.where(inside, 4.0 - 3.0 * t * t, square) / 3.0,
    )


def _deviance(f: Array, y: Array, weight: Array) -> Residual:
    """The signed root of the gamma family's deviance of y from f > 0, both with e added."""
    # Padding has y = 0.
    d = jnp.where(weight != 0, y - f, 0.0) / f
    series = 1.0 + d * (-2 / 3 + d * (1 / 2 + d * (-2 / 5 + d * (1 / 3 - d * (2 / 7)))))
    large = jnp.where(jnp.abs(d) < SMALL, 1.0, d)
    ratio = jnp.where(jnp.abs(d) < SMALL, series, 2.0 * (large - jnp.log1p(large)) / jnp.square(large))
    root = jnp.sqrt(ratio)
    return Residual(-weight * d * root, weight / (f * root))


@functools.partial(jax.jit, static_argnames="metric")
def linearised_weight(metric: Metric, y: Array, weight: Array, floor: Array) -> Array:
    """Weight of the quadratic objective that the metric is near its optimum: the slope at f = y."""
    if metric in QUADRATIC:
        return weight
    if metric == "relative":
        return weight / (jnp.maximum(y, 0.0) + floor)
    return residual(metric, jnp.maximum(y, floor), jnp.zeros_like(y), weight, floor).slope
