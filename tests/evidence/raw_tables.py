"""Draws from raw tables: do a million of them follow the interpolant, and does no point break a bound?

Every measured table that covers two-dimensional outgoing directions, and made lobes down to alpha = 0.02, at
five incidences or more, the highest measured among them; by each method that the table allows. Bins of equal
polar angle and azimuth, 80 x 160, and blocks of 8 x 8 of them. Expected counts are the density that the
sampler states, integrated by nested rules with an error of their own (tests/models/cells.py); at the draws
that density is compared with the table's own evaluation. Bounds are attacked with a million points per table
and method, on sides and corners of their cells more often than not.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import fitter
from fitter.directions import vector_from_spherical
from fitter.errors import SpecError
from fitter.sampling import TableSampler
from fitter.table import Table
from tests.evidence.chi_square import BLOCK, P
from tests.evidence.study import Outcome, Study
from tests.models import cells
from tests.models.statistics import chi_square_p
from tests.sampling.tables import merl, spherical

DRAWS = 1 << 20
ATTACK = 1_000_000
METHODS = ("rejection", "inversion")
AZIMUTH = 0.7

_MEASURED: Mapping[str, Mapping[str, Any]] = {
    "rgl/aurora_white_rgb.bsdf": {}, "rgl/cc_ibiza_sunset_rgb.bsdf": {}, "rgl/cm_military_green_rgb.bsdf": {},
    "rgl/irid_flake_paint1_rgb.bsdf": {}, "rgl/vch_silk_blue_rgb.bsdf": {}, "cornell/garnet_red_RGB.astm": {},
    "mdl/carpaint_blue.mbsdf": {}, "ua_loft/AnoBlackEC1onAlum.bsdf": {}, "ua_loft/AnoBlackEC1onAlum.txt": {},
    "ua_loft/AnoBlackNiTEonSteel.bsdf": {}, "ua_loft/AnoBlackNiTEonSteel.txt": {},
    "retro/retro-3M-jaune.dat": {"quantity": "brdf"}, "retro/retro-gray-tape.dat": {"quantity": "brdf"},
}  # fmt: skip
_MADE: Mapping[str, Callable[[], Table]] = {
    "made: MERL grid, alpha 0.02": lambda: merl(0.02, shape=(90, 90, 180)),
    "made: MERL grid, alpha 0.15": lambda: merl(0.15, shape=(90, 90, 180)),
    "made: 90 x 91 in/out grid, alpha 0.02": lambda: spherical(0.02, 90, 91),
    "made: 90 x 91 in/out grid, alpha 0.1": lambda: spherical(0.1, 90, 91),
}

#: Tests of a full run at most: fine bins and blocks, at five incidences, by both methods.
TESTS = 2 * 5 * len(METHODS) * (len(_MEASURED) + len(_MADE))
#: By Sidak: the p-value below which one of that many independent tests fails.
SIGNIFICANCE = float(-np.expm1(np.log1p(-P) / TESTS))
#: The highest incidence of a made MERL grid; measured ones hold nothing of use beyond.
GRAZING = np.deg2rad(80.0)
#: Estimated error of all expected counts together, as a share of the draws.
MOST_ERROR = 2e-3


def _folder() -> Path:
    beside = Path(__file__).resolve().parents[3] / "shared"
    return Path(os.environ.get("BRDF_SHARED", beside)) / "measured"


def names() -> list[str]:
    """The tables that there are."""
    return [name for name in _MEASURED if (_folder() / name).exists()] + list(_MADE)


def opened(name: str) -> Table:
    return _MADE[name]() if name in _MADE else fitter.load(_folder() / name, **_MEASURED[name])


def expected_counts(sampler: TableSampler, wi: np.ndarray, wo: np.ndarray) -> tuple[np.ndarray, float]:
    """(80, 160) integral of the stated density over each bin, and the estimated error of all together.

    Bins with far fewer draws ``wo`` than beside them are looked at closely: the rim of the measured domain
    may cut off a corner.
    """
    theta, phi = cells.edges(80, 160)
    counts = counted(wo)
    beside = np.stack([np.roll(counts, shift, axis) for shift in (-1, 1) for axis in (0, 1)])
    found, error = cells.integrate(
        lambda at: sampler.pdf(wi, at), theta, phi, absolute=1e-7, relative=1e-3,
        look=(counts > 0) & (counts < 0.7 * beside.max(axis=0)),
    )  # fmt: skip
    return found, float(error.sum())


def counted(wo: np.ndarray) -> np.ndarray:
    """(80, 160) draws in each bin."""
    return np.bincount(cells.bin_of(wo, *cells.edges(80, 160)), minlength=80 * 160).reshape(80, 160)


def p_values(wo: np.ndarray, expected: np.ndarray, inside: np.ndarray | None = None) -> tuple[float, float]:
    """Of the bins, and of blocks of them. A draw where nothing is expected gives 0.

    Expected counts are scaled to the draws: what they sum to is held to 1 apart. inside : (n,) draws that the
    table's evaluation finds measured: a bin of which the integral saw nothing may hold them, and is left out.
    """
    counts = counted(wo)
    unseen = (expected == 0) & (counts > 0)
    if unseen.any():
        there = unseen.reshape(-1)[cells.bin_of(wo, *cells.edges(80, 160))]
        if inside is None or not inside[there].all():
            return 0.0, 0.0
    counts = np.where(unseen, 0, counts)
    found: list[float] = []
    for side in (1, BLOCK):
        a, b = (x.reshape(80 // side, side, 160 // side, side).sum(axis=(1, 3)) for x in (counts, expected))
        found.append(chi_square_p(a.reshape(-1), (b * (a.sum() / b.sum())).reshape(-1)))
    return found[0], found[1]


def judge(name: str, share: float, seed: int) -> Outcome:
    """All incidences and methods; of a sample each incidence runs with probability ``share``."""
    table = opened(name)
    rng = np.random.default_rng([seed, *name.encode()])
    low, high = table.domain.theta_i
    if name.startswith("made: MERL"):
        # Such a grid reaches to 90 deg, where next to nothing is measured, and nothing is accepted.
        high = min(high, GRAZING)
    violations: list[dict[str, Any]] = []
    figures: dict[str, Any] = {"tests": 0, "least p": 1.0, "attacks": 0, "integral off": 0.0}
    accepted: dict[str, list[float]] = {method: [] for method in METHODS}
    cosine: list[float] = []
    for theta_i in np.linspace(low, high, 5):
        chosen, key = rng.random() < share, int(rng.integers(2**31))
        if not chosen:
            continue
        wi = vector_from_spherical(theta_i, AZIMUTH)
        expected: np.ndarray | None = None
        for method in METHODS:
            sampler = TableSampler(table, method=method)
            try:
                envelope = sampler.envelope(wi, allow_extrapolated=True)
            except SpecError as error:
                if error.code != "no-inversion":
                    raise
                continue  # not every table has one
            drawn = sampler.sample(wi, DRAWS, key, allow_extrapolated=True)
            told = {"theta_i_deg": float(np.rad2deg(theta_i)), "method": method, "key": key}
            if expected is None:
                expected, error = expected_counts(sampler, wi, drawn.wo)
                if error > MOST_ERROR:
                    violations.append(
                        {"what": "expected counts are not known well enough", **told, "error": error}
                    )
                off = abs(float(expected.sum()) - 1)
                figures["integral off"] = max(figures["integral off"], off)
                if off > 2 * envelope.info.integral_error + error + 5e-4:
                    violations.append({"what": "the density does not integrate to 1", **told, "off": off})
                violations += [{"what": what, **told} for what in _against_the_table(table, wi, drawn)]
                cosine.append(envelope.info.integral / np.pi / float((drawn.pdf / drawn.wo[:, 2]).max()))
                cosine[-1] /= envelope.info.integral
            ps = p_values(drawn.wo, expected, ~table.evaluate(wi, drawn.wo)[1])
            figures["tests"] += 2
            figures["least p"] = min(figures["least p"], *ps)
            accepted[method].append(drawn.acceptance)
            if min(ps) < SIGNIFICANCE:
                violations.append({"what": "draws do not follow the interpolant", **told, "p": ps})
            if method == "rejection":
                field, bound = envelope.attack(rng, ATTACK // 5)
                figures["attacks"] += len(bound)
                broken = int((field > bound).sum())
                if broken:
                    violations.append({"what": f"{broken} points above their bound", **told})
    for method, values in accepted.items():
        if values:
            figures[f"{method}: mean accepted"] = float(np.mean(values))
            figures[f"{method}: least accepted"] = min(values)
    if cosine:
        figures["cosine envelope"] = float(np.mean(cosine))
    return Outcome(figures, violations)


def _against_the_table(table: Table, wi: np.ndarray, drawn: fitter.Samples) -> list[str]:
    """What is wrong with the stated density at some of the draws, held to ``table.evaluate``."""
    some = slice(0, 20_000)
    value, extrapolated = table.evaluate(wi, drawn.wo[some])
    value = np.maximum(value, 0.0).mean(axis=1) * drawn.wo[some, 2]
    stated = drawn.pdf[some]
    # Nodes are clamped, not what lies between them: next to negative ones (a tenth of the draws of an RGL
    # material beyond the gamut) the two differ a little; elsewhere they are proportional.
    plain = (value > 0) & ~extrapolated
    ratio = stated[plain] / value[plain]
    found: list[str] = []
    if np.mean(np.abs(ratio / np.median(ratio) - 1) < 1e-6) < (0.85 if table.between is not None else 0.999):
        found.append("the stated density is not the table's interpolant")
    if not _highest(table, wi) and extrapolated.mean() > 1e-3:
        found.append("draws lie outside the measured domain")
    return found


def _highest(table: Table, wi: np.ndarray) -> bool:
    """Whether rounding may put the incidence outside the measured ones."""
    return bool(table.evaluate(wi, [0.0, 0.0, 1.0])[1][0])


STUDY = Study(
    name="raw_tables",
    title="Sampling raw tables",
    claim=(
        f"{DRAWS:,} draws follow the interpolant over 80 x 160 bins and over blocks of them, at five "
        f"incidences from the lowest to the highest measured, by each method there is: chi-square, p = {P:g} "
        f"over all tests by Sidak, so {SIGNIFICANCE:.1e} for one; no point of a million breaks a bound. "
        "Beside it, what a cosine envelope under the largest value drawn would accept"
    ),
    columns=(
        "tests", "least p", "integral off", "attacks", "rejection: mean accepted",
        "rejection: least accepted", "inversion: mean accepted", "cosine envelope",
    ),
    models=names,
    judge=judge,
    subject="table",
)  # fmt: skip
