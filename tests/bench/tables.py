"""Tables of known truth, synthesised in memory from the plain NumPy models."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter.formats.merl import SCALES, merl_grid
from fitter.table import Table
from tests.bench import plain

FloatArray = NDArray[np.float64]
MERL = (90, 90, 180)
SMALL = (24, 24, 48)


def merl(name: str, shape: tuple[int, int, int], seed: int, noise: float = 0.01) -> Table:
    """Model ``name`` on a MERL grid, cell centres, RGB, with relative noise; laid out as a loaded file is."""
    grid = merl_grid(shape)
    wi, wo = grid.directions()
    value = plain.evaluate(name, wi, wo)
    value *= 1.0 + noise * np.random.default_rng(seed).standard_normal(value.shape)
    return Table(value=np.ascontiguousarray(value.T).T, grid=grid)


def write_merl(table: Table, path: Path) -> None:
    """The table as a MERL file, cells below the horizon at -1."""
    assert table.grid is not None
    with path.open("wb") as stream:
        stream.write(struct.pack("<3i", *table.grid.shape))
        for plane, scale in zip(table.value.T, SCALES, strict=True):
            np.where(table.mask, plane / scale, -1.0).astype("<f8").tofile(stream)


def pairs(count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """``count`` directions wi, wo, half of the pairs within a few degrees of mirror reflection."""
    rng = np.random.default_rng(seed)
    wi, wo = (_cosine(rng, count) for _ in range(2))
    near = wi[: count // 2] * [-1, -1, 1] + 0.1 * rng.standard_normal((count // 2, 3))
    near[:, 2] = np.abs(near[:, 2]) + 1e-3
    wo[: count // 2] = near / np.linalg.norm(near, axis=1, keepdims=True)
    return wi, wo


def scattered(name: str, count: int, seed: int, noise: float = 0.02) -> Table:
    """Model ``name`` at random pairs, RGB, with the relative noise that sigma states."""
    wi, wo = pairs(count, seed)
    value = plain.evaluate(name, wi, wo)
    sigma = noise * value
    rng = np.random.default_rng([seed, 1])
    return Table(wi=wi, wo=wo, value=value + sigma * rng.standard_normal(value.shape), sigma=sigma)


def _cosine(rng: np.random.Generator, count: int) -> FloatArray:
    """Directions with density cos(theta)/pi, but none closer to the horizon than 3 degrees."""
    z2 = rng.uniform(0.05**2, 1.0, count)
    r, phi = np.sqrt(1.0 - z2), rng.uniform(0.0, 2 * np.pi, count)
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(z2)], axis=1)
