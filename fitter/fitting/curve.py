"""The inside of a separable fit whose coefficients are not free: b = b(l) with fewer linear parameters l.

Oren and Nayar's interreflection has b = (rho, rho^2): no non-negative b, but a curve in their cone. What is
left to minimise for given nonlinear parameters is E(l) = b(l).gram b(l)/2 - rhs.b(l), a polynomial in the
one to three parameters l of a channel: a grid over their box, then Newton's method from its best node.
"""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from fitter.fitting.layout import Layout

#: Nodes of the grid per parameter, by the number of parameters.
NODES = {1: 65, 2: 17, 3: 9}
STEPS = 20


def best_on_curve(layout: Layout, u: Array, gram: Array, rhs: Array) -> Array:
    """l (L,) within its bounds that minimises E, for one channel with search coordinates u (F,).

    ``layout`` is that of a channel alone. Differentiable in u, gram and rhs within the set of active bounds,
    by the implicit function theorem.
    """
    lower, upper = layout.inner_box
    size = len(lower)
    fixed = jax.lax.stop_gradient
    # One term alone would need rhs/gram: no more than twice that where the table states no bound.
    diagonal = jnp.diagonal(gram)
    reach = fixed(2.0 * jnp.max(rhs / jnp.where(diagonal > 0, diagonal, jnp.inf)))
    high = jnp.where(np.isfinite(upper), upper, lower + jnp.maximum(reach, 1e-300))
    span = high - lower

    def energy(z: Array, u: Array, gram: Array, rhs: Array) -> Array:
        b = layout.coefficients(u, (jnp.asarray(lower) + span * z)[:, None])[:, 0]
        return 0.5 * b @ gram @ b - rhs @ b

    nodes = np.linspace(0.0, 1.0, NODES[size])
    grid = jnp.asarray(np.array(list(itertools.product(nodes, repeat=size))))
    here = fixed((u, gram, rhs))
    energies = jax.vmap(lambda z: energy(z, *here))(grid)
    unit = jnp.maximum(jnp.max(jnp.abs(energies)), 1e-300)
    slope = jax.grad(energy)
    hessian = jax.hessian(energy)

    def direction(z: Array, damping: Array) -> tuple[Array, Array]:
        """The damped Newton step and the inverse of the curvature, both zero along active bounds."""
        g, h = slope(z, *here) / unit, hessian(z, *here) / unit
        inside = ~(((z <= 0) & (g > 0)) | ((z >= 1) & (g < 0)))
        both = inside[:, None] & inside
        values, vectors = jnp.linalg.eigh(jnp.where(both, h, jnp.eye(size, dtype=h.dtype)))
        # Downhill whatever the sign of the curvature.
        curvature = jnp.maximum(jnp.abs(values), 1e-12 * jnp.max(jnp.abs(values)) + 1e-300)
        inverse = jnp.where(both, (vectors / (curvature + damping)) @ vectors.T, 0.0)
        return -inverse @ g, inverse

    def step(_: int, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        z, value, damping = carry
        trial = jnp.clip(z + direction(z, damping)[0], 0.0, 1.0)
        found = energy(trial, *here) / unit
        better = found < value
        damping = jnp.where(better, damping / 10, jnp.maximum(10 * damping, 1e-3))
        return jnp.where(better, trial, z), jnp.where(better, found, value), damping

    k = jnp.argmin(energies)
    z, _, _ = jax.lax.fori_loop(0, STEPS, step, (grid[k], energies[k] / unit, jnp.zeros(())))
    z = fixed(z)
    # One more Newton step: it moves z by rounding and carries the derivatives of the optimum.
    _, inverse = direction(z, jnp.zeros(()))
    last = z - fixed(inverse) @ (slope(z, u, gram, rhs) / fixed(unit))
    return jnp.asarray(lower) + span * jnp.clip(last, 0.0, 1.0)
