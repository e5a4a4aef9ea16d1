"""Synthetic tables for the sampler's tests, made without the project's models."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import fitter
from fitter.directions import vector_from_spherical
from fitter.grid import Grid
from fitter.table import Table
from tests.formats.samples import rgl_fields, tensor_file

FloatArray = NDArray[np.float64]


def ggx(wi: FloatArray, wo: FloatArray, alpha: float) -> FloatArray:
    """A GGX mirror-like lobe (Smith, separable masking, no Fresnel), 0 below the horizon."""
    h = wi + wo
    h = h / np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-12)
    c2 = h[..., 2] ** 2
    ndf = 1 / (np.pi * alpha**2 * (c2 + (1 - c2) / alpha**2) ** 2)
    ci, co = wi[..., 2], wo[..., 2]
    up = (ci > 1e-9) & (co > 1e-9)
    ci, co = np.where(up, ci, 1.0), np.where(up, co, 1.0)
    masking = [2 / (1 + np.sqrt(1 + alpha**2 * (1 - c * c) / c**2)) for c in (ci, co)]
    return np.where(up, ndf * masking[0] * masking[1] / (4 * ci * co), 0.0)


def merl(alpha: float, base: float = 0.05, shape: tuple[int, int, int] = (45, 45, 90)) -> Table:
    """A half-difference grid with quadratic theta_h, cell centres, horizon cells masked."""
    n, m, p = shape
    k = np.arange(n) + 0.5
    grid = Grid(
        "half_difference",
        {
            "theta_h": (k / n) ** 2 * np.pi / 2,
            "theta_d": (np.arange(m) + 0.5) / m * np.pi / 2,
            "phi_d": (np.arange(p) + 0.5) / p * np.pi,
        },
        {"phi_d": np.pi},
    )
    wi, wo = grid.directions()
    return Table(value=ggx(wi, wo, alpha) + base, grid=grid)


def spherical(alpha: float, theta_o: int = 60, dphi: int = 61) -> Table:
    """An isotropic grid in incoming and outgoing angles, theta_o at cell centres, two channels."""
    grid = Grid(
        "spherical_isotropic",
        {
            "theta_i": np.deg2rad([0, 15, 30, 45, 60, 75, 80.0]),
            "theta_o": (np.arange(theta_o) + 0.5) / theta_o * np.pi / 2,
            "dphi": np.linspace(0, np.pi, dphi),
        },
    )
    wi, wo = grid.directions()
    lobe = ggx(wi, wo, alpha)
    return Table(value=np.stack([lobe + 0.02, 0.2 * lobe + 0.1], axis=1), grid=grid)


def anisotropic() -> Table:
    """A small in/out grid whose lobe depends on the sample's azimuth."""
    turn = np.arange(24) / 24 * 2 * np.pi
    grid = Grid(
        "spherical",
        {
            "theta_i": np.deg2rad([0, 20, 40, 60.0]),
            "phi_i": turn,
            "theta_o": np.deg2rad(np.arange(0, 90, 6.0)),
            "phi_o": turn,
        },
        {"phi_i": 2 * np.pi, "phi_o": 2 * np.pi},
    )
    wi, wo = grid.directions()
    h = wi + wo
    return Table(value=np.exp(-((h[:, 0] / 0.3) ** 2) - (h[:, 1] / 0.8) ** 2) + 0.05, grid=grid)


def scattered(
    alpha: float, degrees: tuple[float, ...] = (10, 30, 50, 75), count: int = 900, *, one_side: bool = True
) -> Table:
    """Scans on a spiral, plus a denser patch around the specular direction; one side or both."""
    wi: list[FloatArray] = []
    wo: list[FloatArray] = []
    k = np.arange(count) + 0.5
    disk = np.sqrt(k / count)[:, None] * 0.99 * _circle(k * 2.399963229728653)
    for degree in degrees:
        incident = vector_from_spherical(np.deg2rad(degree), 0.0)
        patch = 0.3 * disk[::2] - incident[:2]
        points = np.concatenate([disk, patch])
        points = points[(np.hypot(*points.T) < 0.99) & ((points[:, 1] >= 0) | (not one_side))]
        wo.append(np.concatenate([points, np.sqrt(1 - (points**2).sum(axis=1))[:, None]], axis=1))
        wi.append(np.broadcast_to(incident, wo[-1].shape))
    i, o = np.concatenate(wi), np.concatenate(wo)
    return Table(wi=i, wo=o, value=ggx(i, o, alpha) + 0.05, symmetry="isotropic")


def _circle(angle: FloatArray) -> FloatArray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def adaptive(phi_i: tuple[float, ...] = (0.0,), **options: str) -> Table:
    """As an RGL file holds it, with these stored incident azimuths."""
    return fitter.load(tensor_file(rgl_fields(phi_i)), **options)  # pyright: ignore[reportArgumentType]
