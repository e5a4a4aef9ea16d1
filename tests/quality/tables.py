"""Synthetic tables for the quality checks, made without the project's models."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.directions import vector_from_spherical
from fitter.metadata import Metadata
from fitter.table import Table

FloatArray = NDArray[np.float64]

THETA_I = np.deg2rad([0.0, 15.0, 30.0, 45.0, 60.0, 75.0])
THETA_O = np.deg2rad(np.arange(0.0, 86.0, 5.0))
PHI = np.deg2rad(np.arange(0.0, 360.0, 10.0))


def directions() -> tuple[FloatArray, FloatArray]:
    """An in-plane instrument's raster over the whole hemisphere, (n, 3) each; one sample at the normal."""
    theta_i, theta_o, phi = (a.reshape(-1) for a in np.meshgrid(THETA_I, THETA_O, PHI, indexing="ij"))
    once = (theta_o > 0) | (phi == 0)
    theta_i, theta_o, phi = theta_i[once], theta_o[once], phi[once]
    return vector_from_spherical(theta_i, 0.0), vector_from_spherical(theta_o, phi)


def glossy(wi: FloatArray, wo: FloatArray, diffuse: float = 0.1) -> FloatArray:
    """A reciprocal lobe about the mirror direction that rises towards grazing, on a diffuse base (1/sr)."""
    h = wi + wo
    h = h / np.linalg.norm(h, axis=1, keepdims=True)
    half = np.sum(wi * h, axis=1)
    fresnel = 0.05 + 0.95 * (1 - half) ** 5
    body = diffuse * (1 - 0.3 * (1 - wi[:, 2]) * (1 - wo[:, 2]) + 0.05 * np.sum(wi * wo, axis=1))
    return body + 3.0 * fresnel * np.maximum(h[:, 2], 0.0) ** 60


def table(
    value: FloatArray | None = None, *, wi: FloatArray | None = None, wo: FloatArray | None = None,
    **keywords: Any,
) -> Table:  # fmt: skip
    """Isotropic; by default the clean glossy surface."""
    if wi is None or wo is None:
        wi, wo = directions()
    given = {"symmetry": "isotropic", "metadata": Metadata(name="synthetic"), **keywords}
    return Table(wi=wi, wo=wo, value=glossy(wi, wo) if value is None else value, **given)


def with_metadata(found: Table, **keywords: Any) -> Table:
    """The same samples with other metadata."""
    meta = replace(Metadata(name="synthetic"), **keywords)
    return Table(wi=found.wi, wo=found.wo, value=found.value, symmetry=found.symmetry, metadata=meta)
