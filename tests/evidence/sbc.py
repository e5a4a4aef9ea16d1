"""Are posteriors calibrated? Simulation-based calibration of every family, 200 simulations each.

Truths come from exactly the prior that the posterior uses, flat in its search coordinates (log alpha,
log n), over the ranges stated here: those of the nonlinear parameters are bounds of the fit, and
linear and noise parameters are sampled within theirs, so that they are the prior's (see
:mod:`fitter.calibration.truths`). Albedos go down to 0, F0 and psi over their whole range,
so that bounds, unidentified parameters and exchanged axes are among the truths. Sigma is fixed, whatever the
truth is: one that followed the truth would tell of it. Where the noise is inferred it is drawn, too.
A posterior that does not converge counts as the lowest rank and as an interval that misses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fitter
from fitter import directions, models
from fitter.calibration import calibrate
from tests.evidence.study import Outcome, Study

SIMULATIONS, NOISE, FLOOR = 200, 0.02, 2e-3
CONFIDENCE = 0.99
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """model : its short name. middle : the surface whose values sigma is in proportion to. ranges : of
    truths, where they are not the whole prior."""

    model: str
    middle: Mapping[str, float]
    ranges: Mapping[str, tuple[float, float]]
    noise: str = "table"


_KD, _KS, _ALPHA = {"kd": (0.0, 0.5)}, {"ks": (0.0, 0.3)}, (0.05, 0.6)
_AXES, _MIDDLE_AXES = {"alpha_x": _ALPHA, "alpha_y": _ALPHA}, {"alpha_x": 0.15, "alpha_y": 0.3}
_INFERRED = {"relative_noise": (0.005, 0.05), "noise_floor": (5e-4, 5e-3)}
_WARD = ({"kd": 0.2, "ks": 0.1, "alpha": 0.2}, {**_KD, **_KS, "alpha": _ALPHA})
_TS = ({"kd": 0.2, "ks": 0.5, "f0": 0.3}, {**_KD, "ks": (0.0, 1.0)})
_LAFORTUNE = {"kd": 0.2, "ks": 0.1, "gamma": 0.75, "n": 15.0}
_LOBE = {**_KD, **_KS, "n": (2.0, 100.0)}
_OREN_NAYAR = {"rho": 0.5, "sigma": 0.5}
CASES: Mapping[str, Case] = {
    "ward": Case("ward", *_WARD),
    "ward:anisotropic": Case(
        "ward:anisotropic", {"kd": 0.2, "ks": 0.1, **_MIDDLE_AXES}, {**_KD, **_KS, **_AXES}
    ),
    "torrance_sparrow": Case(
        "torrance_sparrow", {**_TS[0], "alpha": 0.2}, {**_TS[1], "alpha": _ALPHA}
    ),
    "torrance_sparrow:anisotropic": Case(
        "torrance_sparrow:anisotropic", {**_TS[0], **_MIDDLE_AXES}, {**_TS[1], **_AXES}
    ),
    "lafortune": Case("lafortune", _LAFORTUNE, {**_LOBE, "gamma": (0.4, 1.1)}),
    "lafortune:anisotropic": Case(
        "lafortune:anisotropic", {**_LAFORTUNE, "delta": 0.6}, {**_LOBE, "gamma": (-1.1, 1.1)}
    ),
    "oren_nayar": Case("oren_nayar", _OREN_NAYAR, {}),
    "oren_nayar:full": Case("oren_nayar:full", _OREN_NAYAR, {}),
    "ward, noise inferred": Case("ward", _WARD[0], {**_WARD[1], **_INFERRED}, "inferred"),
    "oren_nayar, noise inferred": Case("oren_nayar", _OREN_NAYAR, _INFERRED, "inferred"),
}  # fmt: skip


def goniometer(*, anisotropic: bool) -> tuple[Floats, Floats]:
    """Directions (N, 3) of a grid in and out of the plane of incidence: 408 pairs, or 544 with the sample at
    four azimuths."""
    away = np.deg2rad([0.0, 90.0] if anisotropic else [0.0, 30.0, 60.0, 90.0])
    turned = np.deg2rad([0.0, 45.0, 90.0, 135.0] if anisotropic else [0.0])
    incidences = np.deg2rad([10.0, 30.0, 50.0, 70.0] if anisotropic else [0.0, 15.0, 30.0, 45.0, 60.0, 75.0])
    viewers = np.deg2rad(np.arange(-80.0, 81.0, 10.0))
    azimuth, i, o, phi = (a.ravel() for a in np.meshgrid(turned, incidences, viewers, away, indexing="ij"))
    wi = directions.vector_from_spherical(i, azimuth)
    return wi, directions.vector_from_spherical(o, azimuth + np.pi + phi)


def judge(name: str, share: float, seed: int) -> Outcome:
    case = CASES[name]
    anisotropic = case.model.endswith("anisotropic")
    wi, wo = goniometer(anisotropic=anisotropic)
    f = np.asarray(models.create(case.model, channels=["c"], **case.middle).evaluate(wi, wo))
    sigma = NOISE * f + FLOOR
    value = f + sigma * np.random.default_rng(seed).standard_normal(f.shape)
    table = fitter.Table(
        wi=wi, wo=wo, value=value, sigma=sigma if case.noise == "table" else None, channels=["c"],
        symmetry="anisotropic" if anisotropic else "isotropic", negatives="keep", duplicates="keep",
    )  # fmt: skip
    nonlinear = {p.name for p in models.parameter_table(case.model) if not p.linear}
    bounds = {name: ends for name, ends in case.ranges.items() if name in nonlinear}
    fit = fitter.fit(table, case.model, bounds=bounds)
    found = calibrate(
        table, fit, simulations=max(10, round(SIMULATIONS * share)), around=None, ranges=case.ranges,
        confidence=CONFIDENCE ** (1.0 / len(CASES)), seed=seed,
    )  # fmt: skip
    rows = found.rows()
    shares = [row.covered / found.simulations for row in rows if row.covered is not None]
    figures: dict[str, Any] = {
        "simulations": found.simulations, "failed": found.failed, "parameters": len(shares),
        "smallest p": min(row.p for row in rows),
        "95 % intervals cover": f"{min(shares):.3f} to {max(shares):.3f}",
        "s each": found.seconds / found.simulations,
    }  # fmt: skip
    violations = [
        {
            "what": f"{row.label} is not calibrated",
            "p": row.p,
            "covered": row.covered,
            "failures": found.failures,
        }
        for row in rows
        if not row.uniform or row.covers is False
    ]
    return Outcome(figures, violations)


STUDY = Study(
    name="sbc",
    title="Simulation-based calibration of posteriors",
    claim=(
        f"Truths from the prior, data on a goniometer's grid in and out of plane, {SIMULATIONS} posteriors "
        "each: the ranks of the truths and of their log-likelihoods are uniform (simultaneous bands of the "
        "distribution function), 95 % intervals hold the truth as often as chance allows, all tests of all "
        f"cases together at {100 * CONFIDENCE:g} %. What does not converge counts as a failure"
    ),
    columns=("simulations", "failed", "parameters", "smallest p", "95 % intervals cover", "s each"),
    models=lambda: tuple(CASES),
    judge=judge,
    subject="posterior",
)
