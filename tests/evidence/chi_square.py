"""The chi-square test of the graphics field: do a million draws follow the density that the model states?

Bins of equal polar angle and azimuth, 80 x 160 on the hemisphere and 160 x 160 on the sphere for models that
transmit, and again in blocks of 8 x 8, which find broad errors that many bins drown; what is lost below the
horizon is a bin of its own. Expected counts are the density integrated over each bin by nested rules with an
error of their own (tests/models/cells.py), always in float64, of the incidence as stored in the dtype of the
draws. Bins that expect fewer than 5 are pooled. Ideal components have no density: their number is tested
against its binomial distribution. Sidak's correction over all tests of a full run.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from fitter.models import ReflectanceModel
from fitter.models.base import _sample, cast, mixture_density
from tests.evidence.study import Outcome, Study
from tests.models import MODELS, cells
from tests.models.conftest import draw
from tests.models.statistics import chi_square_p, ideal_share

INCIDENCES = (0.0, 20.0, 45.0, 70.0, 85.0)
DTYPES = ("float64", "float32")
DRAWS = 1 << 20
P = 0.01
BLOCK = 8

#: Tests of a full run: fine bins, blocks, ideal components. A sample is held to the same line.
TESTS = 3 * len(MODELS) * len(INCIDENCES) * len(DTYPES)

#: By Sidak: the p-value below which one of that many independent tests fails.
SIGNIFICANCE = -np.expm1(np.log1p(-P) / TESTS)

#: Of an expected count: a cell is split until its error is below either. 12,800 bins that are each 0.1 % off
#: add 1 to a chi-square of 12,800 +- 160.
ABSOLUTE, RELATIVE = 1e-8, 1e-3

#: Estimated error of all expected counts together, as a share of the draws.
MOST_ERROR = 1e-3


@eqx.filter_jit
def directions(model: ReflectanceModel, wi: jax.Array, key: jax.Array) -> tuple[jax.Array, ...]:
    """What `sample` draws, DRAWS of them, without the weights: directions, valid, is_delta."""
    # The compiler drops what is not asked for.
    wo, _, _, valid, is_delta = _sample(model, wi, DRAWS, key)
    return wo, valid, is_delta


def examine(
    model: ReflectanceModel, degrees: float, dtype: str, seed: int, stated: ReflectanceModel | None = None
) -> dict[str, Any]:
    """Figures of one test: p-values of the spread draws (None where there are none) and of the ideal ones.

    stated : the model whose density the draws are held to, if another.
    """
    t = np.deg2rad(degrees)
    wi = np.array([np.sin(t) * np.cos(0.4), np.sin(t) * np.sin(0.4), np.cos(t)]).astype(dtype)
    drawn = directions(cast(model, wi.dtype), jnp.asarray(wi), jax.random.key(seed))
    wo, valid, is_delta = (np.asarray(part) for part in drawn)
    exact = wi.astype(np.float64)
    claimed = model if stated is None else stated
    ideal = ideal_share(claimed, exact)
    found: dict[str, Any] = {
        "finite": bool(np.isfinite(wo).all()),
        "p": None,
        "p_blocks": None,
        "p_ideal": None,
        "error": 0.0,
    }
    found["p_ideal"] = float(stats.binomtest(int(is_delta.sum()), DRAWS, ideal).pvalue)
    if ideal == 1.0:
        return found
    sphere = model.transmits(model.spec)
    theta, phi = cells.edges(160 if sphere else 80, 160, sphere)
    shape = (len(theta) - 1, len(phi) - 1)
    spread = valid & ~is_delta
    counts = np.bincount(cells.bin_of(wo[spread], theta, phi), minlength=shape[0] * shape[1])
    wide = cast(claimed, np.dtype("float64"))
    inside, error = cells.integrate(
        lambda at: np.asarray(mixture_density(wide, jnp.asarray(exact), jnp.asarray(at))), theta, phi,
        absolute=ABSOLUTE, relative=RELATIVE, look=_suspect(counts.reshape(shape)),
    )  # fmt: skip
    lost = max(1.0 - ideal - inside.sum(), 0.0)
    found["error"] = float(error.sum())
    found["excess"] = float(inside.sum() + ideal - 1.0)
    for p, side in (("p", 1), ("p_blocks", BLOCK)):
        observed, expected = _blocks(counts.reshape(shape), side), _blocks(inside, side)
        found[p] = chi_square_p(np.append(observed, np.sum(~valid)), DRAWS * np.append(expected, lost))
    return found


def _blocks(bins: np.ndarray, side: int) -> np.ndarray:
    rows, columns = bins.shape
    return bins.reshape(rows // side, side, columns // side, side).sum(axis=(1, 3))


def _suspect(counts: np.ndarray) -> np.ndarray:
    """Bins that hold far more draws than their neighbours: a lobe may be narrower than a bin."""
    beside = np.stack([np.roll(counts, shift, axis) for shift in (-1, 1) for axis in (0, 1)])
    return counts > 4 * np.median(beside, axis=0) + 20


def judge(name: str, share: float, seed: int) -> Outcome:
    """All incidences in both dtypes; of a sample each test runs with probability ``share``."""
    rng = np.random.default_rng([seed, *name.encode()])
    ran, least, worst_error, violations = 0, 1.0, 0.0, list[dict[str, Any]]()
    for degrees in INCIDENCES:
        for dtype in DTYPES:
            chosen, key, drawn = rng.random() < share, int(rng.integers(2**31)), int(rng.integers(2**31))
            if not chosen:
                continue
            found = examine(draw(name, drawn), degrees, dtype, key)
            ran += 1
            least = min(least, *(found[p] for p in ("p", "p_blocks", "p_ideal") if found[p] is not None))
            worst_error = max(worst_error, found["error"])
            told = {"theta_i_deg": degrees, "dtype": dtype, "parameters_seed": drawn, "key": key, **found}
            for what, broken in _verdicts(found):
                if broken:
                    violations.append({"what": what, **told})
    figures = {"tests": ran, "least p": least, "error of expected counts": worst_error} if ran else {}
    return Outcome(figures, violations)


def _verdicts(found: dict[str, Any]) -> list[tuple[str, bool]]:
    spread = [found[p] for p in ("p", "p_blocks") if found[p] is not None]
    return [
        ("draws are not finite", not found["finite"]),
        ("draws do not follow the density", min(spread, default=1.0) < SIGNIFICANCE),
        ("the number of ideal draws is not its share", found["p_ideal"] < SIGNIFICANCE),
        ("the density integrates to more than 1", found.get("excess", 0.0) > 1e-4),
        ("expected counts are not known well enough", found["error"] > MOST_ERROR),
    ]


STUDY = Study(
    name="chi_square",
    title="Sampling",
    claim=(
        f"{DRAWS:,} draws follow the stated density over 80 x 160 bins (160 x 160 on the sphere), and over "
        f"blocks of them, at {len(INCIDENCES)} incidences from 0 to 85 degrees in float64 and float32: "
        f"chi-square, p = {P:g} over all {TESTS:,} tests by Sidak, so {SIGNIFICANCE:.1e} for one. It "
        "finds a lobe stated 2 % too wide"
    ),
    columns=("tests", "least p", "error of expected counts"),
    models=lambda: MODELS,
    judge=judge,
)
