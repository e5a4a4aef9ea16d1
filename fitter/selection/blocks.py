"""Blocks: which samples are held out together, so that no fold is predicted from its own neighbours.

Residuals of a model are correlated along a scan, and samples held out at random would be predicted from the
ones beside them: every model looks good, the most flexible one best. So whole incidences are held out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.quality.measured import AT_NORMAL, FEWEST_DIRECTIONS, SAME_INCIDENCE

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

#: Fewer blocks than this say nothing about the spread between them.
FEWEST_BLOCKS = 4
#: More distinct angles than this are bands, of this width.
MOST_SCANS = 24
BAND = np.deg2rad(7.5)
#: Incident azimuths closer than this (radians) are one.
SAME_AZIMUTH = 1e-2


@dataclass(frozen=True)
class Blocks:
    """How samples are dealt into folds.

    block, fold : (n,) of each sample. kind : what a block is; None where there is nothing to hold out.
    words : the same for people, a clause.
    """

    block: IndexArray
    fold: IndexArray
    kind: str | None
    words: str

    @property
    def count(self) -> int:
        return int(self.block.max()) + 1

    @property
    def folds(self) -> int:
        return int(self.fold.max()) + 1 if self.kind else 0


def blocks(
    wi: FloatArray, wo: FloatArray, folds: int, *, isotropic: bool, fewest: int = FEWEST_BLOCKS
) -> Blocks:
    """Blocks of the samples (n, 3) and at most ``folds`` folds of them, every folds-th block in the same one.

    Blocks are incident polar angles, all azimuths together. Where there are fewer than ``fewest`` they are
    incident directions (anisotropic tables), and else scattered polar angles; so they are where it is the
    light that moved along a scan.
    """
    theta_i, phi_i = directions.spherical_from_vector(wi)
    theta_o, _ = directions.spherical_from_vector(wo)
    rings, bands = _scans(theta_i)
    columns, wide = _scans(theta_o)
    scattered = "bands of theta_o, 7.5 deg wide" if wide else "scattered polar angles"
    light_moved = _sparse(theta_i) and not wide and _count(columns) >= FEWEST_BLOCKS
    if light_moved:
        return _dealt(columns, folds, "theta_o", scattered)
    if _count(rings) >= fewest:
        what = "bands of theta_i, 7.5 deg wide" if bands else "incident polar angles"
        return _dealt(rings, folds, "theta_i", what)
    several = _count(rings) > 1
    if not isotropic:
        azimuth = azimuths(theta_i, phi_i)
        both = _numbered(rings * (_count(azimuth) + 1) + azimuth)
        if _count(both) >= FEWEST_BLOCKS:
            return _dealt(both, folds, "incidence", "incident directions")
        several |= _count(both) > 1
    if several and _count(columns) >= FEWEST_BLOCKS:
        return _dealt(columns, folds, "theta_o", scattered)
    none = np.zeros(len(wi), np.intp)
    return Blocks(none, none, None, "one incidence" if not several else "too few directions")


def azimuths(theta_i: FloatArray, phi_i: FloatArray) -> IndexArray:
    """(n,) which of the incident azimuths each sample has; 0 at the normal, where there is none."""
    ring = _rings(np.mod(phi_i + SAME_AZIMUTH / 2, 2 * np.pi), SAME_AZIMUTH)
    return _numbered(np.where(np.sin(theta_i) > AT_NORMAL, ring + 1, 0))


def _dealt(block: IndexArray, folds: int, kind: str, what: str) -> Blocks:
    count = _count(block)
    used = min(folds, count)
    return Blocks(block, block % used, kind, f"{count} {what} in {used} folds")


def _scans(theta: FloatArray) -> tuple[IndexArray, bool]:
    """Distinct angles as labels in increasing order, or bands of them where they are many or nearly empty."""
    label = _rings(theta, SAME_INCIDENCE)
    size = np.bincount(label)
    bands = len(size) > MOST_SCANS or _sparse(theta)
    if bands:
        label = _numbered(np.floor(theta / BAND).astype(np.intp))
        size = np.bincount(label)
    # Stray samples belong to the nearest scan that is one.
    full = np.flatnonzero(size >= max(FEWEST_DIRECTIONS, 0.05 * size.max()))
    if len(full) == 0:
        return np.zeros(len(theta), np.intp), bands
    middle = np.bincount(label, theta) / size
    nearest = np.abs(middle[:, None] - middle[full][None, :]).argmin(axis=1)
    return nearest[label], bands


def _sparse(theta: FloatArray) -> bool:
    """Whether most angles have too few samples to be scans."""
    return float(np.median(np.bincount(_rings(theta, SAME_INCIDENCE)))) < FEWEST_DIRECTIONS


def _rings(angle: FloatArray, within: float) -> IndexArray:
    """Labels of angles, those within ``within`` above the first of a group being one; in increasing order."""
    order = np.argsort(angle, kind="stable")
    ordered = angle[order]
    label = np.zeros(len(angle), np.intp)
    start, ring = 0, 0
    while start < len(order):
        end = int(np.searchsorted(ordered, ordered[start] + within, "right"))
        label[order[start:end]] = ring
        start, ring = end, ring + 1
    return label


def _numbered(label: IndexArray) -> IndexArray:
    return np.unique(label, return_inverse=True)[1].reshape(-1).astype(np.intp)


def _count(label: IndexArray) -> int:
    return int(label.max()) + 1
