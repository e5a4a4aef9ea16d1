"""Quadrature over the upper hemisphere that resolves a lobe of any width around the mirror direction.

Panels shrink geometrically towards the polar angle of wi and towards its azimuth and the opposite one, so
that mirror and retro lobes down to a width of about 1e-4 rad see as many nodes as broad ones. Each panel
carries an 8-point Gauss-Legendre rule. Against independent quadrature: 1e-6 or better where smooth, up to
2e-4 at grazing for V-groove masking, whose kinks cut across panels. One half of the hemisphere is
integrated: isotropic models are symmetric about the plane of incidence.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
THETA_LEVELS = 16
PHI_LEVELS = 14
EVEN_PANELS = 12
HORIZON_LEVELS = 8


def _panels(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    half = 0.5 * np.diff(edges)
    x = edges[:-1, None] + half[:, None] * (1.0 + _NODES)
    return x.reshape(-1), (half[:, None] * _WEIGHTS).reshape(-1)


def _graded(levels: int, far_levels: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on [0, 1]: even panels, split geometrically towards 0 (and 1 where asked)."""
    even = np.arange(1, EVEN_PANELS) / EVEN_PANELS
    near = 0.5 ** np.arange(levels, 0, -1) / EVEN_PANELS
    far = 1.0 - 0.5 ** np.arange(1, far_levels + 1) / EVEN_PANELS
    return _panels(np.concatenate([[0.0], near, even, far, [1.0]]))


def quadrature(wi: Array) -> tuple[Array, Array]:
    """``(wo, weight)``, (M, 3) and (M,), with sum weight g(wo) ~ integral of g cos(theta_o) d omega."""
    theta_i = jnp.arctan2(jnp.hypot(wi[0], wi[1]), wi[2])
    phi_i = jnp.where(theta_i > 0, jnp.arctan2(wi[1], jnp.where(theta_i > 0, wi[0], 1.0)), 0.0)
    s, ws = (jnp.asarray(a) for a in _graded(THETA_LEVELS))
    t, wt = (jnp.asarray(a) for a in _graded(THETA_LEVELS, HORIZON_LEVELS))
    above = 0.5 * jnp.pi - theta_i
    theta = jnp.concatenate([theta_i * (1.0 - s), theta_i + above * t])
    w_theta = jnp.concatenate([theta_i * ws, above * wt])
    q, wq = _graded(PHI_LEVELS)
    quarter = 0.5 * np.pi
    phi = phi_i + jnp.asarray(np.concatenate([quarter * q, np.pi - quarter * q]))
    w_phi = jnp.asarray(np.tile(2.0 * quarter * wq, 2))
    sin_t, cos_t = jnp.sin(theta), jnp.cos(theta)
    wo = jnp.stack(
        [
            (sin_t[:, None] * jnp.cos(phi)).reshape(-1),
            (sin_t[:, None] * jnp.sin(phi)).reshape(-1),
            jnp.broadcast_to(cos_t[:, None], (len(theta), len(phi))).reshape(-1),
        ],
        axis=-1,
    )
    return wo, ((w_theta * sin_t * cos_t)[:, None] * w_phi).reshape(-1)
