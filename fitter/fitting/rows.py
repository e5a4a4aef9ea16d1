"""Rows of samples inside compiled programs: put together, added up, made once.

What XLA fuses decides what a pass over a table takes. With these three, sums of squares and derivatives take
less than half the time of concatenations and matrix products over the same few rows.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax import Array


def settled(*made: Array) -> tuple[Array, ...]:
    """The arrays as they are, made once: XLA would write what they take into each loop that reads them."""
    return jax.lax.optimization_barrier(made)


def stacked(rows: Sequence[Array]) -> Array:
    """(..., R, n) of R rows (..., n)."""
    return joined([row[..., None, :] for row in rows])


def joined(groups: Sequence[Array]) -> Array:
    """(..., R, n) of groups (..., R_i, n) of rows, R = sum R_i. Put in their places one by one: a
    concatenation becomes one loop that asks at each element which row it belongs to, which the processor's
    vectors can't do. Each group takes a part of the program, so what grows with the channels is one."""
    *outer, _, n = groups[0].shape
    made = jnp.zeros((*outer, sum(group.shape[-2] for group in groups), n), groups[0].dtype)
    start = 0
    for group in groups:
        made = made.at[..., start : start + group.shape[-2], :].set(group)
        start += group.shape[-2]
    return made


def combined(rows: Array, weights: Array) -> Array:
    """(..., n) sums of rows (..., K, n) times weights (..., K), added up one by one: for so few, a product of
    matrices takes longer, and nothing can be done in the same loop."""
    return functools.reduce(jnp.add, (rows[..., k, :] * weights[..., k, None] for k in range(rows.shape[-2])))
