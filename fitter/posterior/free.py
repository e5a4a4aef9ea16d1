"""Coordinates without bounds, in which the linear parameters are counted from their best values.

Where samples see only the flank of a lobe, its strength follows its shape along a curve that is far narrower
than it is long, and no normal or difference of walkers has that shape. Given the other parameters u the
linear ones b are normal about the weighted least-squares solution b(u), with precision G(u) = R R^T; so

    z = R(u)^T (b - b(u)),    |db/dz| = 1/det R(u)

is free of that curve (a non-centred parametrisation: O. Papaspiliopoulos, G. Roberts, M. Skoeld, "A general
framework for the parametrization of hierarchical models", Statistical Science 22, 2007). Weights of the
samples are constants: where the noise is inferred, or not Gaussian, z is near normal only, and moves in it
are as valid, since they go by the density of y times |dy/dv|.

What else has bounds is the normal distribution function of its coordinate between them, which makes a normal
of a coordinate that the samples say nothing of, or exp above a single one. Of an inferred noise
sqrt((r f)^2 + e^2) the size is known, but seldom how much of it is relative: r and e lie on an arc. With t a
typical value of the model

    r t = s sin(p),    e = s cos(p),    s = exp(a),    p = pi/2 Phi(b),

and a, b are its coordinates, unless it has ranges of its own.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from fitter.fitting.layout import Layout
from fitter.posterior.density import LARGEST_NOISE, Data, Density, Noise, terms_at, values_at

FloatArray = NDArray[np.float64]
#: Of the precision's diagonal: terms that are the same on all samples have a solution, too.
RIDGE = 1e-10
#: Typical values, at least, of the largest one.
LEAST_TYPICAL = 1e-3
#: A coordinate's distance from its bounds, at least, of their distance or its own: exactly there v is not
#: finite.
EDGE = 1e-14


@dataclass(frozen=True)
class Free:
    """Coordinates v (P,) of a density's y. weight : (C, n) of the values."""

    density: Density
    weight: FloatArray

    def into(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Vectors y (W, P) in these coordinates, and log |dy/dv| (W,)."""
        v, k = y.copy(), self.linear
        low, high = self._ends
        two, one = self._two_ends, self._one_end
        v[:, two] = ndtri(np.clip((y - low)[:, two] / (high - low)[two], EDGE, 1.0 - EDGE))
        v[:, one] = np.log(np.maximum((y - low)[:, one], EDGE))
        r, e = self._noise
        relative, floor = y[:, r] * self._typical, y[:, e]
        v[:, r] = np.log(np.maximum(np.hypot(relative, floor), EDGE * self._typical))
        v[:, e] = ndtri(np.clip(np.arctan2(relative, floor) / (0.5 * math.pi), EDGE, 1.0 - EDGE))
        volume = self._volume(v)
        if k:
            best, root, linear = self._given(y)
            volume += linear
            z = np.einsum("wcji,wcj->wci", root, self._by_channel(y) - best)
            v[:, :k] = z.swapaxes(1, 2).reshape(len(y), k)
        return v, volume

    def back(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Vectors y of v (W, P), and log |dy/dv| (W,)."""
        y, k = v.copy(), self.linear
        low, high = self._ends
        two, one = self._two_ends, self._one_end
        y[:, two] = low[two] + (high - low)[two] * ndtr(v[:, two])
        y[:, one] = low[one] + np.exp(v[:, one])
        r, e = self._noise
        size, part = np.exp(v[:, r]), 0.5 * math.pi * ndtr(v[:, e])
        y[:, r], y[:, e] = size * np.sin(part) / self._typical, size * np.cos(part)
        volume = self._volume(v)
        if k:
            best, root, linear = self._given(y)
            volume += linear
            b = best + np.linalg.solve(root.swapaxes(-1, -2), self._by_channel(v)[..., None])[..., 0]
            y[:, :k] = b.swapaxes(1, 2).reshape(len(y), k)
        return y, volume

    @cached_property
    def linear(self) -> int:
        """How many of the first coordinates are counted from their best values: all linear parameters where
        the coefficients of the terms are these, else none."""
        places, c = self.density.layout, self.density.channels
        names = [p.name for p in places.linear]
        given = jnp.arange(1.0, len(names) + 1.0)[:, None] * jnp.ones(c)
        u = jnp.asarray(0.5 * np.sum(places.box, axis=0))
        found = places.family.coefficients(
            places.spec, dict(zip(names, given, strict=True)), places.nonlinear(u)
        )  # fmt: skip
        same = len(found) == len(names) and np.array_equal(np.stack(found), given)
        return len(names) * c if same else 0

    @cached_property
    def _ends(self) -> tuple[FloatArray, FloatArray]:
        return self.density.prior_range

    @cached_property
    def _two_ends(self) -> NDArray[np.bool_]:
        return self._bounded & np.isfinite(self._ends[1])

    @cached_property
    def _one_end(self) -> NDArray[np.bool_]:
        return self._bounded & ~np.isfinite(self._ends[1])

    @property
    def _bounded(self) -> NDArray[np.bool_]:
        index = np.arange(self.density.size)
        return (index >= self.linear) & ~np.isin(index, self._noise)

    @cached_property
    def _noise(self) -> NDArray[np.intp]:
        """(2, K) coordinates of the relative noise and of the floor where both can be anything."""
        low, high = self._ends
        density = self.density
        count = 0 if density.data.sigma is not None else 2 * density.channels
        pairs = density.search.stop + np.arange(count).reshape(2, -1)
        given = high[pairs[0]] < LARGEST_NOISE
        return pairs[:, (low[pairs] == 0.0).all(axis=0) & np.isinf(high[pairs[1]]) & ~given]

    @cached_property
    def _typical(self) -> FloatArray:
        """(K,) of the model's values in these channels at the density's centre. At most samples a narrow lobe
        is next to nothing, and so is what a relative noise does there."""
        density = self.density
        if not self._noise.size:
            return np.zeros(0)
        assert density.centre is not None
        f = np.abs(np.asarray(_values(density.layout, density.noise, density.centre, density.on_device)))
        largest = np.where(f.any(axis=1), f.max(axis=1), 1.0)
        every = np.maximum(np.median(f, axis=1), LEAST_TYPICAL * largest)
        return every[self._noise[0] - density.search.stop]

    def _volume(self, v: FloatArray) -> FloatArray:
        """log |dy/dv| (W,) of the coordinates that have bounds."""
        low, high = self._ends
        two = v[:, self._two_ends]
        found = -0.5 * np.square(two).sum(axis=1) + v[:, self._one_end].sum(axis=1)
        found += np.log((high - low)[self._two_ends] / math.sqrt(2.0 * math.pi)).sum()
        size, part = v[:, self._noise[0]], v[:, self._noise[1]]
        each = 2.0 * size - 0.5 * np.square(part) + np.log(math.sqrt(0.125 * math.pi) / self._typical)
        return found + each.sum(axis=1)

    def _by_channel(self, y: FloatArray) -> FloatArray:
        return y[:, : self.linear].reshape(len(y), -1, self.density.channels).swapaxes(1, 2)

    def _given(self, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """b(u) (W, C, L), R(u) (W, C, L, L) and log |db/dz| (W,)."""
        density, k = self.density, self.linear
        # No narrower than the prior: a term that no sample sees has no solution of its own.
        least = 1.0 / np.square(density.upper - density.lower)[:k].reshape(-1, density.channels).T
        best, root = density.in_parts(
            lambda part: _best(
                density.layout, density.noise, part, density.on_device, self._weight_on_device, least
            ),
            np.clip(y, density.lower, density.upper),
        )  # fmt: skip
        return best, root, -np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(axis=(-2, -1))

    @cached_property
    def _weight_on_device(self) -> Array:
        return jax.device_put(self.weight)


@functools.partial(jax.jit, static_argnames=("layout", "noise"))
def _values(layout: Layout, noise: Noise, y: Array, data: Data) -> Array:
    return values_at(layout, noise, y, data)[0]


@functools.partial(jax.jit, static_argnames=("layout", "noise"))
def _best(
    layout: Layout, noise: Noise, y: Array, data: Data, weight: Array, least: Array
) -> tuple[Array, Array]:
    def one(row: Array) -> tuple[Array, Array]:
        terms = terms_at(layout, noise, row, data)[0]
        each = terms if layout.mixed else jnp.broadcast_to(terms, (len(weight), *terms.shape))
        weighted = each * weight[:, None]
        precision = weighted @ each.swapaxes(-1, -2)
        ridge = RIDGE * jnp.diagonal(precision, axis1=-2, axis2=-1) + least
        root = jnp.linalg.cholesky(precision + ridge[..., None] * jnp.eye(precision.shape[-1]))
        right = jnp.einsum("ckn,cn->ck", weighted, jnp.asarray(data.value))
        return jax.scipy.linalg.cho_solve((root, True), right[..., None])[..., 0], root

    return jax.lax.map(one, y)
