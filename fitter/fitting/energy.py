"""Whether a fitted model reflects more than arrives, within the incidences that were measured.

A rule of some ten thousand directions, a tenth of that of :meth:`ReflectanceModel.albedo` and good to about
1e-3, looks at a few incidences; the full rule has the word where it comes near 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitter.models.base import ReflectanceModel

FloatArray = NDArray[np.float64]
INCIDENCES = 5
#: From here on the full rule decides.
NEAR = 0.95
#: What the full rule may be wrong by.
TOLERANCE = 5e-4
#: Even panels of a quarter turn, how often the one at the mirror direction is halved, and nodes of each.
PANELS, HALVINGS, NODES = 4, 10, 4


class LargestAlbedo(NamedTuple):
    """The largest directional-hemispherical reflectance found, where, and in which channel (position)."""

    value: float
    theta_i: float
    phi_i: float
    channel: int

    @property
    def exceeds(self) -> bool:
        return self.value > 1.0 + TOLERANCE


def largest_albedo(model: ReflectanceModel, theta_i: tuple[float, float]) -> LargestAlbedo:
    """The largest albedo of the model over incidences theta_i from .. to (rad) and its channels."""
    # Just off the normal an incidence still has the azimuth that the rules take for their panels.
    low, high = (min(max(theta, 1e-6), math.radians(89.5)) for theta in theta_i)
    thetas = np.linspace(low, high, INCIDENCES)
    isotropic = model.isotropic(model.spec)
    psi = next((float(np.mean(v)) for name, v in model.values.items() if name.endswith("psi")), 0.0)
    phis = np.zeros(1) if isotropic else psi + np.array([0.0, 0.5 * math.pi])
    incidences = [(float(theta), float(phi)) for phi in phis for theta in thetas]
    found = albedos(model, incidences, whole=not isotropic)
    worst, channel = np.unravel_index(np.argmax(found), found.shape)
    theta, phi = incidences[worst]
    value = float(found[worst, channel])
    if not value < NEAR:
        exact = np.asarray(model.albedo(_direction(theta, phi)))
        channel = np.argmax(exact)
        value = float(exact[channel])
    return LargestAlbedo(value, theta, phi, int(channel))


def albedos(
    model: ReflectanceModel, incidences: Sequence[tuple[float, float]], whole: bool,
    dtype: type[np.floating[Any]] = np.float64,
) -> FloatArray:  # fmt: skip
    """(I, C) albedos at incidences (theta, phi), evaluated in ``dtype``, by products of Gauss-Legendre panels
    that shrink towards theta_i and towards phi_i and the opposite azimuth; half the hemisphere stands for the
    whole where it is symmetric."""
    near, near_weight = _graded()
    quarter = 0.5 * math.pi
    half = np.concatenate([quarter * near, math.pi - quarter * near])
    turn = np.concatenate([half, -half]) if whole else half
    around = np.tile(quarter * near_weight, 4) if whole else np.tile(2.0 * quarter * near_weight, 2)
    wo: list[FloatArray] = []
    weights: list[FloatArray] = []
    for theta_i, phi_i in incidences:
        theta = np.concatenate([theta_i * (1.0 - near), theta_i + (quarter - theta_i) * near])
        along = np.concatenate([theta_i * near_weight, (quarter - theta_i) * near_weight])
        wo.append(_direction(theta[:, None], (phi_i + turn)[None, :]).reshape(-1, 3))
        weights.append(((along * np.sin(theta) * np.cos(theta))[:, None] * around).reshape(-1))
    wi = np.stack([_direction(theta_i, phi_i) for theta_i, phi_i in incidences])
    values = np.asarray(model.evaluate(wi[:, None, :].astype(dtype), np.stack(wo).astype(dtype)), np.float64)
    return np.einsum("im,imc->ic", np.stack(weights), values)


def _graded() -> tuple[FloatArray, FloatArray]:
    """Nodes and weights on [0, 1]: even panels, the first one halved towards 0."""
    inner = 0.5 ** np.arange(HALVINGS, 0, -1) / PANELS
    edges = np.concatenate([[0.0], inner, np.arange(1, PANELS + 1) / PANELS])
    x, w = np.polynomial.legendre.leggauss(NODES)
    half = 0.5 * np.diff(edges)
    return (edges[:-1, None] + half[:, None] * (1.0 + x)).reshape(-1), (half[:, None] * w).reshape(-1)


def _direction(theta: float | FloatArray, phi: float | FloatArray) -> FloatArray:
    parts = (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) * np.ones_like(phi))
    return np.stack(parts, axis=-1)
