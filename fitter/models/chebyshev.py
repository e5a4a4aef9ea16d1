"""A smooth function of one variable as its Chebyshev series, from its values at the Chebyshev nodes.

It stands in for an integral that depends on a model's parameter and on one variable of the pair: the
integral is computed at a few nodes once, and every pair costs a polynomial.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

#: Steps of the recurrence that the compiler sees as one: over all of them its simplifier gets lost in
#: rewriting, which takes longer and gives a slower program.
_TOGETHER = 8


def nodes(count: int, like: Array) -> Array:
    """The ``count`` Chebyshev nodes in (-1, 1), (count, 1...) against ``like``, in its dtype."""
    x = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    return jnp.asarray(x.reshape(-1, *(1,) * jnp.ndim(like)), like.dtype)


def coefficients(values: Array) -> Array:
    """Of the interpolant through ``values`` (count, ...) at :func:`nodes`."""
    count = len(values)
    k = np.arange(count)
    transform = np.cos(np.pi * np.outer(k, k + 0.5) / count) * np.where(k == 0, 1.0, 2.0)[:, None] / count
    return jnp.tensordot(jnp.asarray(transform, values.dtype), values, axes=1)


def series(terms: Array, x: Array) -> Array:
    """sum_k terms_k T_k(x) by Clenshaw's recurrence; ``terms`` (count, ...) against x in [-1, 1]."""
    later, next_ = jnp.zeros_like(x), jnp.zeros_like(x)
    for k, term in enumerate(terms[:0:-1]):
        later, next_ = 2.0 * x * later - next_ + term, later
        if k % _TOGETHER == _TOGETHER - 1:
            later, next_ = jax.lax.optimization_barrier((later, next_))
    return x * later - next_ + terms[0]


def half_line(like: Array) -> tuple[Array, Array]:
    """Nodes y and weights w, (count, 1...) against ``like``, with int_0^inf g(y) exp(-y) dy ~ sum w g(y).

    Double-exponential rule y = exp(t - exp(-t)) (H. Takahasi and M. Mori 1974): exact to rounding whatever
    algebraic end g has at 0.
    """
    t, step = np.linspace(-4.15, 3.8, 118, retstep=True)
    y = np.exp(t - np.exp(-t))
    w = step * y * (1.0 + np.exp(-t)) * np.exp(-y)
    return _column(y, like), _column(w, like)


def interval(like: Array) -> tuple[Array, Array]:
    """Nodes x and weights w with int_0^1 g(x) dx ~ sum w g(x), as :func:`half_line`: tanh-sinh rule."""
    t, step = np.linspace(-3.4, 3.4, 112, retstep=True)
    x = 1.0 / (1.0 + np.exp(-np.pi * np.sinh(t)))
    one_minus_x = 1.0 / (1.0 + np.exp(np.pi * np.sinh(t)))
    return _column(x, like), _column(step * np.pi * np.cosh(t) * x * one_minus_x, like)


def _column(values: np.ndarray, like: Array) -> Array:
    return jnp.asarray(values.reshape(-1, *(1,) * jnp.ndim(like)), like.dtype)
