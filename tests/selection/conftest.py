"""Goniometer tables of known models, as a lab would measure them: scans, noise, a drifting instrument."""

from __future__ import annotations

import numpy as np
import pytest

import fitter
from fitter import directions, models

#: Truths of one channel. All are compared under the same few candidates, so that few programs are compiled.
TRUTHS = {
    "lambert": {"kd": 0.3},
    "oren_nayar": {"rho": 0.6, "sigma": 0.6},
    "ward": {"kd": 0.15, "ks": 0.1, "alpha": 0.2},
    "torrance_sparrow": {"kd": 0.15, "ks": 0.8, "f0": 0.06, "alpha": 0.25},
    "lafortune": {"kd": 0.15, "ks": 0.2, "gamma": -0.75, "n": 12.0},
}  # fmt: skip


def geometry(
    incidences: tuple[float, ...] = (0, 10, 20, 30, 40, 50, 60, 70), azimuths: tuple[float, ...] = (0,),
    step: float = 10.0,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """wi, wo (n, 3) of scans over theta_o and the azimuth, angles in degrees."""
    theta_o = np.arange(0.0, 71.0, step)
    rows = np.array(
        [
            (i, a, o, a + p)
            for i in incidences for a in azimuths for o in theta_o for p in range(0, 360, 30)
            if o or not p
        ]
    )  # fmt: skip
    i, a, o, p = np.deg2rad(rows).T
    return directions.vector_from_spherical(i, a), directions.vector_from_spherical(o, p)


def measured(
    model: models.ReflectanceModel, seed: int = 1, *, noise: float = 0.02, misfit: float = 0.02,
    sigma: bool = False, **scans: object,
) -> fitter.Table:  # fmt: skip
    """A table of ``model`` with relative noise and, as ``misfit``, scales that differ from scan to scan: an
    instrument that drifts. Residuals are then correlated, and no model predicts those of an unseen scan."""
    wi, wo = geometry(**scans)  # type: ignore[arg-type]
    value = np.asarray(model.evaluate(wi, wo))
    rng = np.random.default_rng(seed)
    _, scan = np.unique(np.round(wi[:, :2], 6), axis=0, return_inverse=True)
    gain = 1 + misfit * rng.standard_normal(int(scan.max()) + 1)[scan.reshape(-1), None]
    u = noise * value
    value = value * gain + u * rng.standard_normal(value.shape)
    return fitter.Table(wi=wi, wo=wo, value=value, sigma=u if sigma else None, channels=["value"])


def known(name: str) -> models.ReflectanceModel:
    """The truth of that name."""
    return models.create(name, channels=("value",), **TRUTHS[name])


@pytest.fixture(scope="session")
def plain() -> tuple[str, ...]:
    return tuple(TRUTHS)
