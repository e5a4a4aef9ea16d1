"""The log-density: independent noise around the model, Gaussian or Student's t, and flat priors.

The model's coordinates are y = [linear parameters (L, C) flattened, nonlinear in search coordinates (T,),
where the noise is inferred the relative noise (C,) and the floor (C,), and offsets of the instrument's
angles in units of their standard uncertainties, which have normal priors].

The scale of a value's noise is its sigma, or sqrt((relative f)^2 + floor^2). Student's t with nu degrees of
freedom has that scale (JCGM 101:2008, 6.4.9.2), and a standard deviation larger by sqrt(nu/(nu - 2)).

What is sampled is x on the whole line, folded into the bounds: y = |x| above 0, a triangle wave between two
bounds. A flat prior stays flat, and a parameter near its bound has a mirror image instead of a wall: a floor
near 0 becomes a smooth bell.
"""

from __future__ import annotations

import functools
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.optimize import minimize

from fitter.fitting.layout import Layout
from fitter.fitting.order import azimuths, ordered_axes
from fitter.posterior.offsets import shifted

FloatArray = NDArray[np.float64]
#: Walkers evaluated at once: more would push the samples out of the cache.
BATCH = 8


class Data(NamedTuple):
    """pair : (6, n). value : (C, n). sigma : (C, n), or None where the noise is inferred.

    tangent, width : (6, n) and (2 or 3,) of the instrument's angles (:mod:`fitter.posterior.offsets`), or
        None.
    """

    pair: FloatArray | Array
    value: FloatArray | Array
    sigma: FloatArray | Array | None
    tangent: FloatArray | Array | None = None
    width: FloatArray | Array | None = None


class Noise(NamedTuple):
    """freedom : degrees of freedom of Student's t, None for Gaussian noise. offsets : how many angles of the
    instrument have one."""

    freedom: float | None = None
    offsets: int = 0


GAUSSIAN = Noise()


@dataclass(frozen=True)
class Density:
    """The log-density of one group of channels that share their nonlinear parameters.

    rows : vectors evaluated by one call of the compiled program, one length for all; 0 for any number.
    lower, upper : (P,) bounds of y; upper infinite for coordinates bounded below by 0 alone.
    centre : (P,) a y whose azimuths are the middle of the half turn they are brought to; None leaves the axes
        of a surface in whatever order they come.
    """

    layout: Layout
    data: Data
    lower: FloatArray
    upper: FloatArray
    centre: FloatArray | None = None
    noise: Noise = GAUSSIAN
    rows: int = 0

    @property
    def size(self) -> int:
        return len(self.lower)

    @cached_property
    def channels(self) -> int:
        return len(self.data.value)

    def __call__(self, x: FloatArray) -> FloatArray:
        """Log-density (W,) at vectors x (W, P).

        Compiled programs release the interpreter's lock, so parts of the vectors are evaluated beside each
        other. Their length is the same on every machine, and so are the values, to the last bit.
        """
        y = self.folded(x)
        rows = self.rows or len(y)
        # The last part is filled up with the last vector again.
        places = np.minimum(np.arange(-(-len(y) // rows) * rows), len(y) - 1).reshape(-1, rows)
        if len(places) == 1:
            found = self._part(y[places[0]])
        else:
            found = np.concatenate(list(self._pool.map(self._part, y[places])))
        return np.where(self.within(x), found[: len(y)], -np.inf)

    def _part(self, y: FloatArray) -> FloatArray:
        return np.asarray(_batch(self.layout, self.noise, y, self._data))

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(os.cpu_count() or 1)

    @cached_property
    def _data(self) -> Data:
        """On the device once and for all: every call would copy it again."""
        return jax.device_put(self.data)

    def within(self, x: FloatArray) -> NDArray[np.bool_]:
        """(...) True where no bounded coordinate is beyond the first mirror image of its range.

        Without an end a coordinate that the data leave open would wander ever further, and the proposals,
        which learn from the walkers, with it. Over whole images a flat prior stays flat.
        """
        span = self.upper - self.lower
        inside = (x >= self.lower - span) & (x <= self.upper + span)
        return np.asarray((inside | np.isinf(span)).all(axis=-1))

    def folded(self, x: FloatArray) -> FloatArray:
        """The model's coordinates y of sampled vectors x, both (..., P)."""
        open_above = ~np.isfinite(self.upper)
        span = np.where(open_above, 1.0, self.upper - self.lower)
        turn = np.mod((x - self.lower) / span, 2.0)
        y = np.where(open_above, np.abs(x), self.lower + span * np.minimum(turn, 2.0 - turn))
        if self.centre is None or len(azimuths(self.layout)) == 0:
            return y
        # The same surface under its other names: otherwise an azimuth hardly known had several modes.
        first = len(self.layout.linear) * self.channels
        u = slice(first, first + len(self.layout.entries))
        y[..., u] = ordered_axes(self.layout, y[..., u], self.centre[u])
        return y

    def mode(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The mode near y and the covariance (P, P) of the normal that has its curvature (Laplace)."""
        for _ in range(2):
            # In units of the curvature L-BFGS sees a round valley.
            scale = 1.0 / np.sqrt(np.diagonal(self._curvature(y)))
            found = minimize(
                self._negative, y / scale, args=(scale,), jac=True, method="L-BFGS-B",
                bounds=list(zip(self.lower / scale, self.upper / scale, strict=True)),
                options={"maxiter": 500, "ftol": 1e-14, "gtol": 1e-5},
            )  # fmt: skip
            y = np.clip(found.x * scale, self.lower, self.upper)
        h = self._curvature(y)
        scale = np.sqrt(np.diagonal(h))
        values, vectors = np.linalg.eigh(h / np.outer(scale, scale))
        return y, (vectors / np.maximum(values, 1e-10)) @ vectors.T / np.outer(scale, scale)

    def _curvature(self, y: FloatArray) -> FloatArray:
        """-Hessian (P, P) at y, no direction wider than a fraction of its range.

        Where the mode is pressed against a bound with slope g the folded density falls as exp(-g |x|):
        g^2 is its curvature.
        """
        slope = np.asarray(_value_and_grad(self.layout, self.noise, y, self._data)[1])
        pressed = ((y <= self.lower) & (slope < 0)) | ((y >= self.upper) & (slope > 0))
        h = -np.nan_to_num(np.asarray(_hessian(self.layout, self.noise, y, self._data)))
        h = 0.5 * (h + h.T) + np.diag(np.where(pressed, slope * slope, 0.0))
        typical = np.maximum(np.abs(y), 1e-3 * np.median(np.abs(self.data.value)))
        width = np.where(np.isfinite(self.upper), 0.3 * (self.upper - self.lower), typical)
        # One factor after the other: the product of two small widths underflows.
        values, vectors = np.linalg.eigh(np.nan_to_num(h * width[:, None] * width))
        return (vectors * np.maximum(values, 1.0)) @ vectors.T / width[:, None] / width

    def _negative(self, z: FloatArray, scale: FloatArray) -> tuple[float, FloatArray]:
        value, slope = _value_and_grad(self.layout, self.noise, z * scale, self._data)
        return -float(value), -np.asarray(slope) * scale


def log_likelihood(layout: Layout, noise: Noise, y: Array, data: Data) -> Array:
    """Log-likelihood () of one vector y in the model's coordinates, and the log-prior of offsets, up to a
    constant."""
    c, t = data.value.shape[0], len(layout.entries)
    names = [p.name for p in layout.linear]
    linear = y[: len(names) * c].reshape(len(names), c)
    u = y[len(names) * c : len(names) * c + t]
    rest = y[len(names) * c + t :]
    coefficients = layout.family.coefficients(
        layout.spec, dict(zip(names, linear, strict=True)), layout.nonlinear(u)
    )  # fmt: skip
    pair = jnp.asarray(data.pair)
    prior = jnp.zeros(())
    if noise.offsets:
        z = rest[len(rest) - noise.offsets :]
        pair = shifted(pair, jnp.asarray(data.tangent), z * jnp.asarray(data.width))
        prior = -0.5 * jnp.sum(jnp.square(z))
    terms = layout.terms(u, pair)
    each = terms.swapaxes(0, 1) if layout.mixed else terms
    # Written out: an einsum of these shapes becomes a matrix product ten times as slow.
    f = sum((b[:, None] * term for b, term in zip(coefficients[1:], each[1:], strict=True)),
            coefficients[0][:, None] * each[0])  # fmt: skip
    if data.sigma is not None:
        squares = jnp.square((data.value - f) / data.sigma)
        if noise.freedom is None:
            return prior - 0.5 * jnp.sum(squares)
        return prior - 0.5 * (noise.freedom + 1.0) * jnp.sum(jnp.log1p(squares / noise.freedom))
    scale = jnp.square(rest[: 2 * c]).reshape(2, c, 1)
    variance = scale[0] * f * f + scale[1]
    squares = jnp.square(data.value - f) / variance
    if noise.freedom is not None:
        squares = (noise.freedom + 1.0) * jnp.log1p(squares / noise.freedom)
    return prior - 0.5 * jnp.sum(squares + jnp.log(variance))


@functools.partial(jax.jit, static_argnames=("layout", "noise"))
def _batch(layout: Layout, noise: Noise, y: Array, data: Data) -> Array:
    def one(row: Array) -> Array:
        found = log_likelihood(layout, noise, row, data)
        return jnp.where(jnp.isfinite(found), found, -jnp.inf)

    return jax.lax.map(one, y, batch_size=BATCH)


@functools.partial(jax.jit, static_argnames=("layout", "noise"))
def _value_and_grad(layout: Layout, noise: Noise, y: Array, data: Data) -> tuple[Array, Array]:
    return jax.value_and_grad(lambda v: log_likelihood(layout, noise, v, data))(y)


@functools.partial(jax.jit, static_argnames=("layout", "noise"))
def _hessian(layout: Layout, noise: Noise, y: Array, data: Data) -> Array:
    return jax.hessian(lambda v: log_likelihood(layout, noise, v, data))(y)
