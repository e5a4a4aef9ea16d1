"""The log-density: independent Gaussian noise around the model, flat priors in the search coordinates.

The vector is x = [linear parameters (L, C) flattened, nonlinear in search coordinates (T,), and where the
noise is inferred ln(relative noise) (C,), ln(floor) (C,)], with standard deviation
sqrt((relative f)^2 + floor^2) of a value.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.optimize import minimize

from fitter.fitting.layout import Layout

FloatArray = NDArray[np.float64]
#: Walkers evaluated at once: more would push the samples out of the cache.
BATCH = 8


@dataclass(frozen=True)
class Density:
    """The log-density of one group of channels that share their nonlinear parameters.

    pair : (6, n). value : (n, C). sigma : (n, C), or None where the noise is inferred.
    lower, upper : (P,) bounds of x.
    """

    layout: Layout
    pair: FloatArray
    value: FloatArray
    sigma: FloatArray | None
    lower: FloatArray
    upper: FloatArray

    @property
    def size(self) -> int:
        return len(self.lower)

    def __call__(self, x: FloatArray) -> FloatArray:
        """Log-density (W,) at vectors (W, P), -inf outside the bounds."""
        found = _batch(self.layout, x, self.pair, self.value, self.sigma, self.lower, self.upper)
        return np.asarray(found)

    def maximum(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The mode near x and the covariance (P, P) of the normal that has its curvature (Laplace)."""
        span = np.where(np.isfinite(self.upper), self.upper - self.lower, np.maximum(np.abs(x), 1e-3))
        scale = np.where(np.isfinite(self.upper), 0.01 * span, 0.01 * span + 1e-9)
        # Solve in units of the curvature, so that L-BFGS sees a round valley.
        curvature = -np.diagonal(self._hessian(self._inside(x)))
        scale = np.where(curvature > 0, 1.0 / np.sqrt(np.maximum(curvature, 1e-30)), scale)

        def negative(z: FloatArray) -> tuple[float, FloatArray]:
            value, slope = _value_and_grad(self.layout, z * scale, self.pair, self.value, self.sigma)
            return -float(value), -np.asarray(slope) * scale

        box = [(lo, hi if np.isfinite(hi) else None) for lo, hi in zip(self.lower / scale, self.upper / scale, strict=True)]
        found = minimize(
            negative, self._inside(x) / scale, jac=True, bounds=box, method="L-BFGS-B",
            options={"maxiter": 500, "ftol": 1e-13, "gtol": 1e-6},
        )  # fmt: skip
        mode = np.clip(found.x * scale, self.lower, self.upper)
        return mode, self._laplace(mode, span)

    def _inside(self, x: FloatArray) -> FloatArray:
        return np.clip(x, self.lower, self.upper)

    def _hessian(self, x: FloatArray) -> FloatArray:
        return np.asarray(_hessian(self.layout, x, self.pair, self.value, self.sigma))

    def _laplace(self, mode: FloatArray, span: FloatArray) -> FloatArray:
        """Inverse curvature, with directions the data leave open limited to a fraction of the range."""
        h = -self._hessian(mode)
        unit = 0.25 * span
        scaled = h * np.outer(unit, unit)
        values, vectors = np.linalg.eigh(np.nan_to_num(0.5 * (scaled + scaled.T)))
        return (vectors / np.maximum(values, 1.0)) @ vectors.T * np.outer(unit, unit)


def log_likelihood(
    layout: Layout, x: Array, pair: Array, value: Array, sigma: Array | None
) -> Array:
    """Log-likelihood () of one vector x, up to a constant."""
    c, t = value.shape[1], len(layout.free)
    names = [p.name for p in layout.family.parameter_table(layout.spec) if p.linear]
    linear = x[: len(names) * c].reshape(len(names), c)
    u = x[len(names) * c : len(names) * c + t]
    coefficients = layout.family.coefficients(layout.spec, dict(zip(names, linear, strict=True)))
    f = jnp.einsum("kn,kc->nc", layout.terms(u, pair), jnp.stack(coefficients))
    if sigma is not None:
        return -0.5 * jnp.sum(jnp.square((value - f) / sigma))
    noise = jnp.exp(2.0 * x[len(names) * c + t :]).reshape(2, c)
    variance = noise[0] * f * f + noise[1]
    return -0.5 * jnp.sum(jnp.square(value - f) / variance + jnp.log(variance))


@functools.partial(jax.jit, static_argnames="layout")
def _batch(
    layout: Layout, x: Array, pair: Array, value: Array, sigma: Array | None, lower: Array, upper: Array
) -> Array:
    def one(row: Array) -> Array:
        ok = jnp.all((row >= lower) & (row <= upper))
        found = log_likelihood(layout, jnp.clip(row, lower, upper), pair, value, sigma)
        return jnp.where(ok & jnp.isfinite(found), found, -jnp.inf)

    return jax.lax.map(one, x, batch_size=BATCH)


@functools.partial(jax.jit, static_argnames="layout")
def _value_and_grad(
    layout: Layout, x: Array, pair: Array, value: Array, sigma: Array | None
) -> tuple[Array, Array]:
    return jax.value_and_grad(lambda v: log_likelihood(layout, v, pair, value, sigma))(x)


@functools.partial(jax.jit, static_argnames="layout")
def _hessian(layout: Layout, x: Array, pair: Array, value: Array, sigma: Array | None) -> Array:
    return jax.hessian(lambda v: log_likelihood(layout, v, pair, value, sigma))(x)
