"""Do standard uncertainties cover at their rate? Simulated tables of a known surface, 500 of each model.

The data are well specified: the model's own values with Gaussian noise that the table states, truths well
inside their bounds. Under the metric ``measurement`` u is the likelihood's curvature; under ``cbrt`` with
the same noise it is the sandwich, which has to find the noise for itself. For every parameter the intervals
y +- u and y +- U, U = k u with k of Student's t at 95 %, have to hold the truth in 68.27 % and 95 % of the
tables, within a binomial band that is corrected for the number of tests. A parameter that ends on a bound
states no u and counts as neither.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import stats

import fitter
from fitter import models
from tests.evidence.study import Outcome, Study
from tests.fitting.conftest import scattered

TABLES, SAMPLES, NOISE = 500, 400, 0.03
LEVELS = {"68 %": 0.6827, "95 %": 0.95}
METRICS = ("measurement", "cbrt")
TRUTHS: Mapping[str, Mapping[str, float]] = {
    "ward": {"kd": 0.2, "ks": 0.1, "alpha": 0.2},
    "torrance_sparrow": {"kd": 0.2, "ks": 0.6, "f0": 0.3, "alpha": 0.25},
    "lafortune": {"kd": 0.2, "ks": 0.3, "gamma": 0.7, "n": 15.0},
    "oren_nayar": {"rho": 0.5, "sigma": 0.6},
}
P = 0.01
#: Tests of a full run: every parameter by level and metric.
TESTS = sum(map(len, TRUTHS.values())) * len(LEVELS) * len(METRICS)
SIGNIFICANCE = -np.expm1(np.log1p(-P) / TESTS)


def judge(name: str, share: float, seed: int) -> Outcome:
    truth = TRUTHS[name]
    model = models.create(name, channels=["c"], **truth)
    count = max(40, round(TABLES * share))
    hits = {m: {level: {parameter: list[bool]() for parameter in truth} for level in LEVELS} for m in METRICS}
    bounded = 0
    for k in range(count):
        table = scattered(model, seed=seed + k, n=SAMPLES, noise=NOISE, sigma=True)
        for metric in METRICS:
            fit = fitter.fit(table, name, metric=metric)
            for parameter, value in truth.items():
                estimate = fit.parameters[parameter]
                u = float(np.ravel(estimate.standard_uncertainty)[0])
                if estimate.at_bound[0] is not None or not np.isfinite(u):
                    bounded += 1
                    continue
                off = abs(float(np.ravel(estimate.value)[0]) - value)
                hits[metric]["68 %"][parameter].append(off < u)
                hits[metric]["95 %"][parameter].append(
                    off < float(np.ravel(estimate.expanded_uncertainty())[0])
                )
    figures: dict[str, Any] = {"tables": count, "no u": bounded}
    violations: list[dict[str, Any]] = []
    for metric in METRICS:
        for words, level in LEVELS.items():
            shares: list[float] = []
            for parameter, found in hits[metric][words].items():
                inside = sum(found)
                shares.append(inside / len(found))
                p = float(stats.binomtest(inside, len(found), level).pvalue)
                if p < SIGNIFICANCE:
                    violations.append({
                        "what": f"u of {parameter} does not cover", "metric": metric, "level": words,
                        "share": shares[-1], "p": p,
                    })  # fmt: skip
            figures[f"{metric}, {words}"] = f"{min(shares):.3f} to {max(shares):.3f}"
    return Outcome(figures, violations)


STUDY = Study(
    name="coverage",
    title="Coverage of standard uncertainties",
    claim=(
        f"y +- u holds the truth in 68 % of {TABLES} simulated tables ({SAMPLES} samples, {100 * NOISE:g} % "
        "of noise, truths inside their bounds), y +- U in 95 %, k of U from u's degrees of freedom, for "
        f"every parameter, within binomial bands for {TESTS} tests: the curvature under the metric "
        "measurement, the sandwich under cbrt. The figures are the lowest and the highest share among the "
        "parameters"
    ),
    columns=("tables", *(f"{metric}, {words}" for metric in METRICS for words in LEVELS), "no u"),
    models=lambda: tuple(TRUTHS),
    judge=judge,
)
