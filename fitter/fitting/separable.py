"""The linear inside of a separable fit: non-negative coefficients for given nonlinear parameters.

Golub and Pereyra 1973: with f = sum_k b_k t_k(u) the best b for given u is a small linear problem, and the
objective left over depends on u alone. Here b >= 0, solved exactly by trying all 2^K supports (K <= 4).
"""

from __future__ import annotations

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import Array
from jax.scipy.linalg import cho_factor, cho_solve

from fitter.fitting.layout import Layout

#: Relative ridge on the scaled normal matrix: below it columns are the same column.
RIDGE = 1e-13


def non_negative(gram: Array, rhs: Array) -> Array:
    """b >= 0 (K,) that minimises b.gram b / 2 - rhs.b: exact, differentiable within its support."""
    k = gram.shape[0]
    scale = jnp.sqrt(jnp.maximum(jnp.diagonal(gram), 1e-300))
    g, r = gram / (scale[:, None] * scale), rhs / scale
    eye = jnp.eye(k, dtype=gram.dtype)
    supports = jnp.asarray(np.array(list(itertools.product([0.0, 1.0], repeat=k))), gram.dtype)

    def solve(support: Array) -> Array:
        both = support[:, None] * support
        masked = g * both + eye * (1.0 - support) + RIDGE * eye
        return cho_solve(cho_factor(masked, lower=True), r * support) * support

    candidates = jax.vmap(solve)(jax.lax.stop_gradient(supports))
    costs = 0.5 * jnp.einsum("si,ij,sj->s", candidates, g, candidates) - candidates @ r
    feasible = (candidates >= 0).all(axis=1) & jnp.isfinite(costs)
    best = jnp.argmin(jnp.where(feasible, costs, jnp.inf))
    return solve(supports[jax.lax.stop_gradient(best)]) / scale


@functools.partial(jax.jit, static_argnames="layout")
def coefficients(layout: Layout, u: Array, pair: Array, y: Array, weight: Array) -> Array:
    """The best coefficients (K, C) at search coordinates u, for y and weight (n, C)."""
    terms = layout.terms(u, pair)

    def one(y_c: Array, w_c: Array) -> Array:
        a = terms * w_c
        return non_negative(a @ a.T, a @ (w_c * y_c))

    return jax.vmap(one, in_axes=1, out_axes=1)(y, weight)


@functools.partial(jax.jit, static_argnames="layout")
def residuals(layout: Layout, u: Array, pair: Array, y: Array, weight: Array) -> Array:
    """(n, C) weighted residuals with the best coefficients at u put in."""
    b = coefficients(layout, u, pair, y, weight)
    return weight * (jnp.einsum("kn,kc->nc", layout.terms(u, pair), b) - y)


@functools.partial(jax.jit, static_argnames="layout")
def screen(layout: Layout, candidates: Array, pair: Array, y: Array, weight: Array) -> Array:
    """Reduced objective (S,) at candidates (S, T). One after the other: a batch would not fit the cache."""
    return jax.lax.map(lambda u: jnp.sum(jnp.square(residuals(layout, u, pair, y, weight))), candidates)


@functools.partial(jax.jit, static_argnames=("layout", "steps"))
def solve_many(
    layout: Layout, starts: Array, pair: Array, y: Array, weight: Array, steps: int = 60
) -> tuple[Array, Array, Array]:
    """Levenberg-Marquardt (optimistix) on the reduced problem from each start (S, T).

    Returns u (S, T), objective (S,), coefficients (S, K, C). The box becomes the whole line by a
    sigmoid, so that every step stays inside. Residuals are scaled to a sum of squares of order 1: in
    absolute units LM's own tolerances stop it early on a million residuals.
    """
    low, high = (jnp.asarray(side) for side in layout.box)
    total = jnp.sqrt(jnp.maximum(jnp.sum(jnp.square(weight * y)), 1e-300))
    solver = optx.LevenbergMarquardt(rtol=1e-8, atol=1e-10)

    def inside(z: Array) -> Array:
        return low + (high - low) * jax.nn.sigmoid(z)

    def scaled(z: Array, args: None) -> Array:
        del args
        return residuals(layout, inside(z), pair, y, weight).reshape(-1) / total

    def one(u0: Array) -> tuple[Array, Array, Array]:
        share = jnp.clip((u0 - low) / (high - low), 1e-3, 1.0 - 1e-3)
        z0 = jnp.log(share) - jnp.log1p(-share)
        found = optx.least_squares(scaled, solver, z0, max_steps=steps, throw=False)
        u = inside(found.value)
        objective = jnp.sum(jnp.square(scaled(found.value, None))) * total * total
        return u, objective, coefficients(layout, u, pair, y, weight)

    return jax.lax.map(one, starts)
