"""Integrals of a density over cells of the sphere, by nested Gauss-Kronrod rules with their own error.

Nothing of the models' own quadrature or lobes is used: this is what they are tested against.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: Kronrod's extension of the 3-point Gauss rule on [-1, 1]: 7 nodes, their weights, and Gauss's weights.
_NODES = np.array([-0.960491268708020283, -0.774596669241483377, -0.434243749346802558, 0.0])
_KRONROD = np.array([0.104656226026467265, 0.268488089868333440, 0.401397414775962222, 0.450916538658474142])
_GAUSS = np.array([0.0, 5.0 / 9.0, 0.0, 8.0 / 9.0])
NODES = np.concatenate([_NODES, -_NODES[-2::-1]])
KRONROD = np.concatenate([_KRONROD, _KRONROD[-2::-1]])
GAUSS = np.concatenate([_GAUSS, _GAUSS[-2::-1]])

#: Cells evaluated together: one shape, one compiled program.
BATCH = 256

#: Halvings of a bin's sides at most: 2e-6 rad of a bin of 1 degree.
DEEPEST = 13

Density = Callable[[np.ndarray], np.ndarray]


def edges(bins_theta: int, bins_phi: int, sphere: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Edges of bins of equal polar angle and azimuth of the upper hemisphere, or of the sphere."""
    top = np.pi if sphere else np.pi / 2
    return np.linspace(0.0, top, bins_theta + 1), np.linspace(0.0, 2 * np.pi, bins_phi + 1)


def integrate(
    density: Density,
    theta: np.ndarray,
    phi: np.ndarray,
    *,
    absolute: float,
    relative: float = 0.0,
    look: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Integrals (len(theta)-1, len(phi)-1) of ``density`` over each bin, and their estimated errors.

    density : takes (BATCH * 49, 3) unit vectors, returns as many values per sr.
    absolute, relative : a cell is split in four until its error is below either (of its integral).
    look : (len(theta)-1, len(phi)-1) True where the bin is known to matter: split twice at least, so that
        a lobe narrower than the nodes' spacing is not overlooked.
    """
    rows, columns = len(theta) - 1, len(phi) - 1
    row, column = (g.reshape(-1) for g in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    cell = np.stack([theta[row], theta[row + 1], phi[column], phi[column + 1]], axis=1)
    owner = row * columns + column
    total, error = np.zeros(rows * columns), np.zeros(rows * columns)
    watched = np.zeros(rows * columns, bool) if look is None else look.reshape(-1)
    for depth in range(DEEPEST + 1):
        fine, coarse = _rules(density, cell)
        off = np.abs(fine - coarse)
        split = (off > np.maximum(absolute, relative * np.abs(fine))) | (watched[owner] & (depth < 2))
        split &= depth < DEEPEST
        np.add.at(total, owner[~split], fine[~split])
        np.add.at(error, owner[~split], off[~split])
        if not split.any():
            break
        cell, owner = _quarters(cell[split]), np.tile(owner[split], 4)
    return total.reshape(rows, columns), error.reshape(rows, columns)


def _quarters(cell: np.ndarray) -> np.ndarray:
    t0, t1, p0, p1 = cell.T
    t, p = 0.5 * (t0 + t1), 0.5 * (p0 + p1)
    return np.concatenate(
        [np.stack(c, axis=1) for c in ((t0, t, p0, p), (t, t1, p0, p), (t0, t, p, p1), (t, t1, p, p1))]
    )


def _rules(density: Density, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kronrod's and Gauss's integral over each cell (m, 4)."""
    fine, coarse = np.empty(len(cell)), np.empty(len(cell))
    for start in range(0, len(cell), BATCH):
        part = cell[start : start + BATCH]
        count = len(part)
        # The last batch is filled up: every call has the same shape.
        part = np.concatenate([part, np.repeat(part[-1:], BATCH - count, axis=0)])
        t0, t1, p0, p1 = part.T
        half_t, half_p = 0.5 * (t1 - t0)[:, None], 0.5 * (p1 - p0)[:, None]
        t, p = t0[:, None] + half_t * (1 + NODES), p0[:, None] + half_p * (1 + NODES)
        wo = directions(t[:, :, None], p[:, None, :])
        value = density(wo.reshape(-1, 3)).reshape(BATCH, len(NODES), len(NODES))
        value = value * (np.sin(t) * half_t)[:, :, None] * half_p[:, :, None]
        fine[start : start + count] = np.einsum("cij,i,j->c", value, KRONROD, KRONROD)[:count]
        coarse[start : start + count] = np.einsum("cij,i,j->c", value, GAUSS, GAUSS)[:count]
    return fine, coarse


def directions(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """(..., 3) unit vectors of polar angles and azimuths that broadcast."""
    theta, phi = np.broadcast_arrays(theta, phi)
    s = np.sin(theta)
    return np.stack([s * np.cos(phi), s * np.sin(phi), np.cos(theta)], axis=-1)


def bin_of(wo: np.ndarray, theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Index of the bin of each direction (n, 3) in the flattened bins."""
    wo = np.asarray(wo, np.float64)
    polar = np.arctan2(np.hypot(wo[:, 0], wo[:, 1]), wo[:, 2])
    turn = np.arctan2(wo[:, 1], wo[:, 0]) % (2 * np.pi)
    row = np.clip(np.searchsorted(theta, polar, side="right") - 1, 0, len(theta) - 2)
    column = np.clip(np.searchsorted(phi, turn, side="right") - 1, 0, len(phi) - 2)
    return row * (len(phi) - 1) + column
