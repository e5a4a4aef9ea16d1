"""Directional-hemispherical reflectance of a subject at many incidences, quickly.

By importance: half vectors of GGX distributions as wide as the lobe and wider, and directions by the cosine,
weighted by the balance heuristic (E. Veach 1997), at points of Sobol's sequence. What averages over patches
say of a narrow lobe is scaled to this.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.export.lobe import lobe_of
from fitter.export.subject import Subject
from fitter.formats.rgl_writer import Lobe, lobe_width

FloatArray = NDArray[np.float64]

#: Directions of each kind for an incidence, and incidences that are evaluated together.
_POINTS, _TOGETHER = 256, 256
#: Values are scaled to the reflectance where those that are have this part of it, and by this at most.
_LEAST, _FURTHEST = 0.02, 1.5


def scale(known: FloatArray, rest: FloatArray, some: FloatArray) -> FloatArray:
    """The factor that makes up a reflectance of ``rest`` and the scaled ``some``, within limits."""
    factor = np.where(some > _LEAST * known, (known - rest) / np.where(some > 0, some, 1.0), 1.0)
    return np.clip(factor, 1 / _FURTHEST, _FURTHEST)


def reflectance(subject: Subject, wi: FloatArray) -> FloatArray:
    """Of the first channel (n,) at incidences (n, 3), negative and missing values as 0."""
    lobes = _lobes(subject)
    found = np.empty(len(wi))
    for start in range(0, len(wi), _TOGETHER):
        part = slice(start, start + _TOGETHER)
        found[part] = _weighted(subject, lobes, wi[part])[1].sum(axis=1) / _POINTS
    return found


def drawn(subject: Subject, wi: FloatArray, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Pairs (M, 3), ``count`` of each incidence (n, 3), nearly by the first channel's f_r cos(theta_o):
    chosen among the points by their weights."""
    wo, weight = _weighted(subject, _lobes(subject), wi)
    rng = np.random.default_rng(seed)
    total = weight.cumsum(axis=1)
    total /= np.where(total[:, -1:] > 0, total[:, -1:], 1.0)
    index = np.stack([np.searchsorted(one, rng.random(count)) for one in total])
    index = np.minimum(index, wo.shape[1] - 1)
    kept = np.take_along_axis(weight, index, axis=1) > 0
    chosen = np.take_along_axis(wo, index[..., None], axis=1)
    return np.broadcast_to(wi[:, None], chosen.shape)[kept], chosen[kept]


def _weighted(subject: Subject, lobes: tuple[Lobe, ...], wi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Directions (n, P, 3) of each incidence and f_r cos(theta_o) over their density (n, P)."""
    qmc: Any = importlib.import_module("scipy.stats.qmc")
    points = qmc.Sobol(2, scramble=True, seed=2).random(_POINTS)
    some = np.repeat(wi, 3 * _POINTS, axis=0).reshape(-1, 3 * _POINTS, 3)
    wo = np.concatenate([*(_mirrored(one, points, some) for one in lobes), _cosine(points, some)], axis=1)
    return wo, _estimates(subject, lobes, some, wo)


def _lobes(subject: Subject) -> tuple[Lobe, ...]:
    """One as wide as the subject's, and a wider one."""
    if subject.table is None:
        lobe = lobe_of(subject)
    else:
        index = np.flatnonzero(subject.table.mask)
        width = lobe_width(*subject.table.directions(index), subject.table.value[index].mean(axis=1))
        lobe = Lobe(width, width)
    return lobe, Lobe(lobe.along**0.5, lobe.across**0.5, lobe.psi)


def _mirrored(lobe: Lobe, points: FloatArray, wi: FloatArray) -> FloatArray:
    """Directions (n, P, 3) that normals of the distribution, drawn by D cos(theta_m), mirror wi to."""
    slope = np.sqrt(points[:, 0] / (1.0 - points[:, 0]))
    angle = 2 * np.pi * points[:, 1]
    x, y = lobe.along * slope * np.cos(angle), lobe.across * slope * np.sin(angle)
    c, s = np.cos(lobe.psi), np.sin(lobe.psi)
    m = np.stack([c * x - s * y, s * x + c * y, np.ones_like(x)], axis=1)
    m /= np.linalg.norm(m, axis=1)[:, None]
    some = wi[:, : len(points)]
    return 2 * (some * m).sum(axis=-1, keepdims=True) * m - some


def _cosine(points: FloatArray, wi: FloatArray) -> FloatArray:
    theta = np.arcsin(np.sqrt(points[:, 0]))
    wo = directions.vector_from_spherical(theta, 2 * np.pi * points[:, 1])
    return np.broadcast_to(wo, (len(wi), *wo.shape))


def _estimates(subject: Subject, lobes: tuple[Lobe, ...], wi: FloatArray, wo: FloatArray) -> FloatArray:
    up = wo[..., 2] > 0
    i, o = wi[up], wo[up]
    m = i + o
    m /= np.linalg.norm(m, axis=1)[:, None]
    density = o[:, 2] / np.pi
    for lobe in lobes:
        density = density + lobe.density(m) * m[:, 2] / (4 * (i * m).sum(axis=1))
    value = subject.evaluate(i, o)[0][:, 0]
    value = np.where(np.isfinite(value), np.maximum(value, 0.0), 0.0)
    each = np.zeros(up.shape)
    each[up] = value * o[:, 2] / density
    return each
