"""The linear inside of a separable fit: non-negative coefficients for given nonlinear parameters.

Golub and Pereyra 1973: with f = sum_k b_k t_k(u) the best b for given u is a small linear problem, and the
objective left over depends on u alone. Here b >= 0, solved exactly by trying all 2^K supports (K <= 4);
where the coefficients are not free, :mod:`fitter.fitting.curve` takes its place.
"""

from __future__ import annotations

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import cho_factor, cho_solve
from numpy.typing import ArrayLike, NDArray

from fitter.fitting import rows
from fitter.fitting.curve import best_on_curve
from fitter.fitting.layout import Layout
from fitter.programs import kept

FloatArray = NDArray[np.float64]
#: Relative ridge on the scaled normal matrix: below it columns are the same column.
RIDGE = 1e-13
#: Starts that one program has room for.
STARTS = 32


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
def inner(layout: Layout, u: Array, pair: Array, y: Array, weight: Array) -> Array:
    """The best inner vector (M, C) at search coordinates u, for y (n, C) and weight (n, C) or (n, 1)."""
    weight = jnp.broadcast_to(weight, y.shape)
    terms = layout.terms(u, pair)

    def normal(terms_c: Array, y_c: Array, w_c: Array) -> tuple[Array, Array]:
        a = terms_c * w_c
        return a @ a.T, a @ (w_c * y_c)

    each = 0 if layout.mixed else None
    if layout.coefficients_are_free:

        def one(terms_c: Array, y_c: Array, w_c: Array) -> Array:
            return non_negative(*normal(terms_c, y_c, w_c))

        return jax.vmap(one, in_axes=(each, 1, 1), out_axes=1)(terms, y, weight)

    def on_curve(u_c: Array, terms_c: Array, y_c: Array, w_c: Array) -> Array:
        return best_on_curve(layout.alone, u_c, *normal(terms_c, y_c, w_c))

    own = u[layout.where] if layout.mixed else u
    return jax.vmap(on_curve, in_axes=(each, each, 1, 1), out_axes=1)(own, terms, y, weight)


def model(layout: Layout, terms: Array, coefficients: Array) -> Array:
    """(C, n) the values of the model from its terms and coefficients (K, C)."""
    return rows.combined(terms if layout.mixed else terms[None], coefficients.T)


@functools.partial(jax.jit, static_argnames="layout")
def values(layout: Layout, u: Array, inner: Array, pair: Array) -> Array:
    """(n, C) the values of the model at pairs (6, n) with the inner vector (M, C)."""
    return model(layout, layout.terms(u, pair), layout.coefficients(u, inner)).T


@functools.partial(jax.jit, static_argnames="layout")
def residuals(layout: Layout, u: Array, pair: Array, y: Array, weight: Array) -> Array:
    """(n, C) weighted residuals with the best coefficients at u put in."""
    return weight * (values(layout, u, inner(layout, u, pair, y, weight), pair) - y)


@kept("layout")
def screen(layout: Layout, candidates: Array, pair: Array, y: Array, weight: Array) -> Array:
    """Reduced objective (S, C) of each channel at candidates (S, T). One after the other: a batch would not
    fit the cache."""
    return jax.lax.map(
        lambda u: jnp.sum(jnp.square(residuals(layout, u, pair, y, weight)), axis=0), candidates
    )


def solve_many(
    layout: Layout, starts: ArrayLike, pair: ArrayLike, y: ArrayLike, weight: ArrayLike, steps: int = 60,
    moving: ArrayLike | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Levenberg-Marquardt (optimistix) on the reduced problem from each start (S, T).

    Returns u (S, T), objective (S,), inner vectors (S, M, C). ``moving`` : (T,) False for entries to be held.
    One program serves any number of starts: compiling takes longer than solving.
    """
    # By NumPy: each operation of JAX outside of a program is one more to trace in every new process.
    starts, pair, y, weight = (np.asarray(a) for a in (starts, pair, y, weight))
    count, t = starts.shape
    held = np.ones(t, bool) if moving is None else np.asarray(moving)
    found = [
        _solve_some(
            layout, np.pad(starts[k : k + STARTS], ((0, max(0, k + STARTS - count)), (0, 0)), mode="edge"),
            np.asarray(min(STARTS, count - k)), pair, y, weight, held, steps,
        )
        for k in range(0, count, STARTS)
    ]  # fmt: skip
    u, objective, inner = (np.concatenate(part)[:count] for part in zip(*found, strict=True))
    return u, objective, inner


@kept("layout", "steps")
def _solve_some(
    layout: Layout, starts: Array, count: Array, pair: Array, y: Array, weight: Array, moving: Array,
    steps: int,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """The first ``count`` of the starts (STARTS, T).

    The box becomes the whole line by a sigmoid, so that every step stays inside. Residuals are scaled to a
    sum of squares of order 1: in absolute units LM's own tolerances stop it early on a million residuals.
    """
    import optimistix as optx  # a fifth of a second, and a program that is kept needs none of it

    low, high = (jnp.asarray(side) for side in layout.box)
    total = jnp.sqrt(jnp.maximum(jnp.sum(jnp.square(weight * y)), 1e-300))
    solver = optx.LevenbergMarquardt(rtol=1e-8, atol=1e-10)

    def one(u0: Array) -> tuple[Array, Array, Array]:
        share = jnp.clip((u0 - low) / (high - low), 1e-3, 1.0 - 1e-3)
        z0 = jnp.log(share) - jnp.log1p(-share)

        def inside(z: Array) -> Array:
            return jnp.where(moving, low + (high - low) * jax.nn.sigmoid(z), u0)

        def scaled(z: Array, args: None) -> tuple[Array, tuple[Array, Array, Array]]:
            del args
            u = inside(z)
            b = inner(layout, u, pair, y, weight)
            r = (weight * (values(layout, u, b, pair) - y)).reshape(-1)
            # What is wanted of the end comes along: computed after it, it would be compiled once more.
            return r / total, (u, jnp.sum(jnp.square(r)), b)

        found = optx.least_squares(scaled, solver, z0, has_aux=True, max_steps=steps, throw=False)
        # That of the end: the solution's own aux is of the accepted step before it.
        return found.state.aux

    def step(k: Array, ends: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        u, objective, b = one(starts[k])
        return ends[0].at[k].set(u), ends[1].at[k].set(objective), ends[2].at[k].set(b)

    # Not the shapes of one(): that traces the solver once more.
    shape = jax.eval_shape(lambda u: inner(layout, u, pair, y, weight), starts[0])
    b = jnp.zeros((len(starts), *shape.shape), shape.dtype)
    return jax.lax.fori_loop(0, count, step, (jnp.zeros_like(starts), jnp.zeros(len(starts), b.dtype), b))
