"""Dense tables that no reflectance model made: measured ones, and light traced over explicit surfaces."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import fitter
from fitter.grid import Grid
from fitter.table import Table
from tests.bench.machine import ROOT
from tests.bench.measuring import Size

sys.path.insert(0, str(ROOT / "data"))

FloatArray = NDArray[np.float64]
SEED = 77
#: Rows of each axis: incidences (degrees), their azimuths (degrees), outgoing angles, outgoing azimuths.
PLANS = {
    "glossy_paint": (np.linspace(2, 80, 14), (0.0,), 32, 45),
    "diffuse_plaster": (np.linspace(2, 80, 14), (0.0,), 32, 45),
    "brushed_metal": (np.linspace(5, 75, 5), (0.0, 30.0, 60.0, 90.0), 24, 48),
}
PHOTONS, RAYS = 400_000, 300


@dataclass(frozen=True)
class Dense:
    """A table and the standard deviation (N, C) of its random errors, as known or as estimated."""

    name: str
    table: Table
    sigma: FloatArray


def dense(size: Size) -> Iterator[Dense]:
    """The measured ones, where they are, and the traced ones."""
    shared = Path(os.environ.get("BRDF_SHARED", ROOT.parent / "shared")) / "measured"
    found = [*sorted((shared / "rgl").glob("*.bsdf")), shared / "mdl" / "carpaint_blue.mbsdf"]
    for path in found if shared.is_dir() and not size.quick else []:
        table = fitter.load(path)
        yield Dense(f"{path.parent.name} {path.stem}", table, _estimated(table))
    for name in size.pick(list(PLANS), ["diffuse_plaster"]):
        yield traced(name, size)


def _estimated(table: Table) -> FloatArray:
    from fitter.quality import noise
    from fitter.quality.measured import Measured

    measured = Measured.of(table, 0, usable=True)
    found = noise.estimate(noise.scatter(measured), noise.smoothness(measured))
    assert found is not None
    return found.deviation(table.value)


def traced(name: str, size: Size) -> Dense:
    """A sample table's surface under its virtual gonioreflectometer, on a product grid.

    The instrument is that of data/tables without what makes tables ragged: no positions are hidden or lost.
    """
    from generate import settings, stream, surface_of, vector
    from goniometer import Facet, count_glints, gather_body, illuminate
    from surface import normals

    theta_i, phi_i, rows, columns = PLANS[name]
    theta_i, rows, columns = size.pick((theta_i, rows, columns), (theta_i[::5], 8, 12))
    given = settings()[name]
    field, facet, instrument = surface_of(given), Facet.create(**given["facet"]), given["instrument"]
    isotropic = len(phi_i) == 1
    theta_o = np.linspace(1.0, 85.0, rows)
    phi = (np.arange(columns) + 0.5 * isotropic) * (180.0 if isotropic else 360.0) / columns
    around, azimuth = (part.reshape(-1) for part in np.meshgrid(theta_o, phi, indexing="ij"))
    # Azimuths count from the light, as in a grid.
    wo = vector(around, azimuth)
    values: list[FloatArray] = []
    sigmas: list[FloatArray] = []
    for k, (theta, turn) in enumerate((t, p) for t in theta_i for p in phi_i):
        light = illuminate(
            field, facet, vector(theta, turn), size.pick(PHOTONS, 4096), stream(SEED, 1, k),
            spin=given["spin"], keep_arrivals=size.pick(131_072, 4096),
        )  # fmt: skip
        own = [stream(SEED, 2, k, r) for r in range(wo.shape[1])]
        aperture = np.deg2rad(instrument["aperture_deg"])
        body, body_error = gather_body(field, facet, light.arrivals, wo, aperture, size.pick(RAYS, 40), own)
        glint, glint_error = count_glints(light, wo, aperture)
        flux, cosine = body + glint, np.cos(np.deg2rad(around))[:, None]
        own_noise = np.hypot(instrument["relative_noise"] * flux, instrument["floor"])
        drawn = normals(stream(SEED, 3, k), flux.shape)
        values.append((flux + own_noise * drawn) / cosine)
        sigmas.append(np.sqrt(own_noise**2 + body_error**2 + glint_error**2) / cosine)
    axes = {"theta_i": theta_i, "theta_o": theta_o, "dphi": phi}
    if not isotropic:
        axes = {"theta_i": theta_i, "phi_i": np.array(phi_i), "theta_o": theta_o, "phi_o": phi}
    grid = Grid(
        "spherical_isotropic" if isotropic else "spherical",
        {key: np.deg2rad(axis) for key, axis in axes.items()}, {} if isotropic else {"phi_o": 2 * np.pi},
    )  # fmt: skip
    return Dense(f"traced {name}", Table(value=np.concatenate(values), grid=grid), np.concatenate(sigmas))
