"""The log-density: independent noise around the model, Gaussian or Student's t, and flat priors.

The model's coordinates are y = [linear parameters (L, C) flattened, nonlinear in search coordinates (T,),
where the noise is inferred the relative noise (C,) and the floor (C,), and offsets of the instrument's
angles in units of their standard uncertainties, which have normal priors].

The scale of a value's noise is its sigma, or sqrt((relative f)^2 + floor^2). Student's t with nu degrees of
freedom has that scale (JCGM 101:2008, 6.4.9.2), and a standard deviation larger by sqrt(nu/(nu - 2)).

Beyond the bounds there is nothing. A surface has one name only: its axes in their order, its azimuths within
a quarter turn of where they were at the mode.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
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
from fitter.fitting.order import Swap, azimuths, ordered_axes, swaps
from fitter.posterior.offsets import shifted

FloatArray = NDArray[np.float64]
#: Upper bound of the inferred relative noise: beyond it "relative" has lost its meaning.
LARGEST_NOISE = 3.0
#: Walkers evaluated at once: more would push the samples out of the cache.
BATCH = 8
#: Coordinates that differ by less are the same: renaming a surface rounds.
SAME = 1e-9


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
    centre : (P,) a y whose azimuths are the middle of the half turn they keep to; None lets the axes of a
        surface have any name.
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

    @property
    def search(self) -> slice:
        """Where the search coordinates are in y."""
        first = len(self.layout.linear) * self.channels
        return slice(first, first + len(self.layout.entries))

    def __call__(self, y: FloatArray) -> FloatArray:
        """Log-density (W,) at vectors y (W, P).

        Compiled programs release the interpreter's lock, so parts of the vectors are evaluated beside each
        other. Their length is the same on every machine, and so are the values, to the last bit.
        """
        inside = self.within(y)
        # Beyond its bounds a model may be anything, and slow.
        y = np.where(inside[:, None], y, np.clip(y, self.lower, self.upper))
        (found,) = self.in_parts(lambda part: (_batch(self.layout, self.noise, part, self.on_device),), y)
        return np.where(inside, found, -np.inf)

    def in_parts(self, program: Callable[[FloatArray], tuple[Array, ...]], y: FloatArray) -> list[FloatArray]:
        """What a program finds at vectors y (W, P), each (W, ...), from parts of ``rows`` of them."""
        rows = self.rows or len(y)
        # The last part is filled up with the last vector again.
        places = np.minimum(np.arange(-(-len(y) // rows) * rows), len(y) - 1).reshape(-1, rows)

        def one(part: FloatArray) -> list[FloatArray]:
            return [np.asarray(found) for found in program(part)]

        parts = [one(y[places[0]])] if len(places) == 1 else list(self._pool.map(one, y[places]))
        return [np.concatenate(each)[: len(y)] for each in zip(*parts, strict=True)]

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(os.cpu_count() or 1)

    @cached_property
    def on_device(self) -> Data:
        """The data on the device once and for all: every call would copy it again."""
        return jax.device_put(self.data)

    def within(self, y: FloatArray) -> NDArray[np.bool_]:
        """(...) True where y (..., P) is within its bounds and no other name of the same surface."""
        inside = ((y >= self.lower) & (y <= self.upper)).all(axis=-1)
        if self._named:
            inside &= (np.abs(self.renamed(y) - y) < SAME).all(axis=-1)
        return np.asarray(inside)

    def folded(self, x: FloatArray) -> FloatArray:
        """Vectors x (..., P) mirrored at their bounds until they are within, surfaces by their one name."""
        open_above = ~np.isfinite(self.upper)
        span = np.where(open_above, 1.0, self.upper - self.lower)
        turn = np.mod((x - self.lower) / span, 2.0)
        mirrored = self.lower + span * np.minimum(turn, 2.0 - turn)
        return self.renamed(np.where(open_above, self.lower + np.abs(x - self.lower), mirrored))

    def renamed(self, y: FloatArray) -> FloatArray:
        """The same surfaces y (..., P), their axes in order and their azimuths about those of ``centre``."""
        if not self._named:
            return y
        assert self.centre is not None
        y, u = y.copy(), self.search
        y[..., u] = ordered_axes(self.layout, y[..., u], self.centre[u])
        return y

    @property
    def twins(self) -> list[Callable[[FloatArray], FloatArray]]:
        """Involutions (W, P) -> (W, P) that lead to the other end of the one name: Lafortune's lobes whose
        deltas are 45 deg away from 0 have two, a quarter turn apart, and what is near on the surface is far
        in y. Other axes meet where they are equal, and the azimuth says nothing."""
        if not self._named:
            return []

        def twin(swap: Swap, y: FloatArray) -> FloatArray:
            y, u = y.copy(), self.search
            y[:, u] = swap.across(y[:, u])
            return self.renamed(y)

        return [functools.partial(twin, swap) for swap in swaps(self.layout) if len(swap.delta)]

    @property
    def prior_range(self) -> tuple[FloatArray, FloatArray]:
        """(P,) ends of the ranges; of azimuths, the half turn that they have one name in, and of Lafortune's
        delta the half of its range."""
        low, high = self.lower.copy(), self.upper.copy()
        if self._named:
            assert self.centre is not None
            where = self.search.start + azimuths(self.layout)
            low[where], high[where] = self.centre[where] - np.pi / 2, self.centre[where] + np.pi / 2
            for swap in swaps(self.layout):
                if len(swap.delta) == 1 and not len(swap.first):
                    where = self.search.start + swap.delta
                    low[where], high[where] = -np.pi / 4, np.pi / 4
        return low, high

    @cached_property
    def _named(self) -> bool:
        return self.centre is not None and len(azimuths(self.layout)) > 0

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

        Where the mode is pressed against a bound with slope g the density falls as exp(-g distance): g^2 is
        taken for its curvature.
        """
        slope = np.asarray(_value_and_grad(self.layout, self.noise, y, self.on_device)[1])
        pressed = ((y <= self.lower) & (slope < 0)) | ((y >= self.upper) & (slope > 0))
        h = -np.nan_to_num(np.asarray(_hessian(self.layout, self.noise, y, self.on_device)))
        h = 0.5 * (h + h.T) + np.diag(np.where(pressed, slope * slope, 0.0))
        typical = np.maximum(np.abs(y), np.median(np.abs(self.data.value)))
        width = np.where(np.isfinite(self.upper), 0.3 * (self.upper - self.lower), typical)
        # One factor after the other: the product of two small widths underflows.
        values, vectors = np.linalg.eigh(np.nan_to_num(h * width[:, None] * width))
        return (vectors * np.maximum(values, 1.0)) @ vectors.T / width[:, None] / width

    def _negative(self, z: FloatArray, scale: FloatArray) -> tuple[float, FloatArray]:
        value, slope = _value_and_grad(self.layout, self.noise, z * scale, self.on_device)
        return -float(value), -np.asarray(slope) * scale


def log_likelihood(layout: Layout, noise: Noise, y: Array, data: Data) -> Array:
    """Log-likelihood () of one vector y in the model's coordinates, and the log-prior of offsets, up to a
    constant."""
    c = data.value.shape[0]
    f, rest = values_at(layout, noise, y, data)
    prior = -0.5 * jnp.sum(jnp.square(rest[len(rest) - noise.offsets :]))
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


def values_at(layout: Layout, noise: Noise, y: Array, data: Data) -> tuple[Array, Array]:
    """The model's values (C, n) at a vector y in its coordinates, and what is in y behind its parameters."""
    c = data.value.shape[0]
    names = [p.name for p in layout.linear]
    linear = dict(zip(names, y[: len(names) * c].reshape(len(names), c), strict=True))
    terms, u, rest = terms_at(layout, noise, y, data)
    coefficients = layout.family.coefficients(layout.spec, linear, layout.nonlinear(u))
    each = terms.swapaxes(0, 1) if layout.mixed else terms
    # Written out: an einsum of these shapes becomes a matrix product ten times as slow.
    f = sum((b[:, None] * term for b, term in zip(coefficients[1:], each[1:], strict=True)),
            coefficients[0][:, None] * each[0])  # fmt: skip
    return f, rest


def terms_at(layout: Layout, noise: Noise, y: Array, data: Data) -> tuple[Array, Array, Array]:
    """The terms (K, n), or (C, K, n) where channels have parameters of their own, of a vector y in the
    model's coordinates; the search coordinates in it; and what is behind them."""
    c, t = data.value.shape[0], len(layout.entries)
    first = len(layout.linear) * c
    u, rest = y[first : first + t], y[first + t :]
    pair = jnp.asarray(data.pair)
    if noise.offsets:
        z = rest[len(rest) - noise.offsets :]
        pair = shifted(pair, jnp.asarray(data.tangent), z * jnp.asarray(data.width))
    return layout.terms(u, pair), u, rest


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
