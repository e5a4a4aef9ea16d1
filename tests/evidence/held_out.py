"""What the uncertainties of real tables are worth: measurements held out, and fits to disjoint halves.

Bands of new measurements (:func:`fitter.posterior.predictive`) of fits to a random half of a table, and to
every second scan, are held against the other half, beside bands of relative noise and a floor, which know no
correlation. Fits to the even and to the odd scans are compared by their robust intervals and by those that
take residuals as independent. Needs the measured tables (BRDF_SHARED).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fitter
from fitter.formats import load_all
from fitter.posterior import predictive, robust
from fitter.selection.blocks import blocks
from fitter.table import Table
from tests.evidence.inputs import inputs
from tests.evidence.study import Outcome, Study

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
MODELS = ("torrance_sparrow", "lafortune:2")
#: Tables of a source, and samples of a table, at most.
TABLES, SAMPLES = 6, 4_000
#: Scans in all from which on the parameters of its halves are compared.
ENOUGH_SCANS = 10
#: In its own channel only: channels of a table share their misfit.
CHANNEL = 0


def judge(name: str, share: float, seed: int) -> Outcome:
    rows: dict[str, list[dict[str, float]]] = defaultdict(list)
    agree: list[tuple[bool, bool]] = []
    tables = list(_tables(name))
    for table in tables[: max(1, round(len(tables) * share))]:
        rng = np.random.default_rng(seed)
        whole = _part(table, np.sort(rng.permutation(np.flatnonzero(table.mask))[:SAMPLES]))
        scan = blocks(whole.wi, whole.wo, 6, isotropic=True)
        random = rng.permutation(len(whole)) < len(whole) // 2
        for model in MODELS:
            rows["random"].append(_held(whole, random, model, seed))
            if scan.kind is None:
                continue
            even = scan.block % 2 == 0
            rows["scans"] += [_held(whole, half, model, seed) for half in (even, ~even)]
            if scan.count >= ENOUGH_SCANS:
                agree += _agreement(whole, even, model)
    figures: dict[str, Any] = {"tables": len(tables)}
    violations: list[dict[str, Any]] = []
    for kind, found in rows.items():
        cover = np.array([row["inside"] for row in found])
        bright, score = (float(np.mean([row[k] for row in found])) for k in ("bright", "score"))
        low, high = (0.9, 0.98) if kind == "random" else (0.9, 1.0)
        well = float(np.mean((cover >= low) & (cover <= high)))
        figures |= {
            f"{kind}: cover": float(cover.mean()), f"{kind}: within": well, f"{kind}: brightest": bright,
            f"{kind}: score": score,
        }  # fmt: skip
        wanted = {"within": (well, 0.8), "better score than": (0.5 if kind == "random" else 1.0, score)}
        violations += [
            {"what": f"{kind}: {what}", "found": a, "wanted": b} for what, (a, b) in wanted.items() if a < b
        ]
    if agree:
        ours, naive = np.mean(agree, axis=0)
        figures |= {"halves agree": float(ours), "independent": float(naive), "pairs": len(agree)}
        if ours < 0.9:
            violations.append({"what": "halves agree", "found": float(ours), "wanted": 0.9})
    return Outcome(figures, violations)


def _tables(source: str) -> Iterator[Table]:
    """Tables of a folder, evenly spaced among many."""
    found: list[Table] = []
    for one in inputs():
        if one.measured and one.name.partition("/")[0] == source:
            damaged, data = next(iter(one.files.items()))
            loaded = load_all(one.sources(damaged, data), **one.options)
            found += [table for table in loaded if table.mask.sum() > 100]
    return iter([found[k] for k in np.unique(np.linspace(0, len(found) - 1, TABLES).astype(int))])


def _part(table: Table, index: NDArray[np.intp]) -> Table:
    wi, wo = table.directions(index)
    # A measurement below zero is a measurement: what is fitted is what is held out.
    return Table(wi=wi, wo=wo, value=table.value[index, CHANNEL], negatives="keep")


def _held(whole: Table, used: BoolArray, model: str, seed: int) -> dict[str, float]:
    part = _part(whole, np.flatnonzero(used))
    fit = fitter.fit(part, model)
    found = predictive(part, fit, robust(part, fit), seed)
    wi, wo, y = whole.wi[~used], whole.wo[~used], whole.value[~used]
    lower, upper = found.predict(wi, wo)
    f = np.asarray(fit.model.evaluate(wi, wo))
    plain = 1.96 * found.processes[0].scale(f)
    inside = (y >= lower) & (y <= upper)
    return {
        "inside": float(inside.mean()), "bright": float(inside[y >= np.quantile(y, 0.95)].mean()),
        "score": _score(lower, upper, y) / _score(f - plain, f + plain, y),
    }  # fmt: skip


def _score(lower: FloatArray, upper: FloatArray, y: FloatArray) -> float:
    """The interval score of 95 % intervals (T. Gneiting, A. Raftery 2007, eq. 43); smaller is better."""
    outside = np.maximum(lower - y, 0.0) + np.maximum(y - upper, 0.0)
    return float(np.mean(upper - lower + 2 / 0.05 * outside))


def _agreement(whole: Table, even: BoolArray, model: str) -> list[tuple[bool, bool]]:
    """Of each parameter whether the fits to both halves agree within 95 %: robustly, and independently."""
    halves: list[Mapping[str, tuple[float, float, float]]] = []
    for half in (even, ~even):
        part = _part(whole, np.flatnonzero(half))
        fit = fitter.fit(part, model)
        found = robust(part, fit)
        rows: dict[str, tuple[float, float, float]] = {}
        for k, label in enumerate(fit.labels):
            value = float(np.ravel(fit.parameters[label.partition("[")[0]].value)[0])
            wide = found.coverage_factor * found.standard_uncertainty[label]
            rows[label] = (value, wide, 1.96 * float(np.sqrt(fit.covariance[k, k])))
        halves.append(rows)
    pairs: list[tuple[bool, bool]] = []
    for label, (a, wide_a, narrow_a) in halves[0].items():
        b, wide_b, narrow_b = halves[1][label]
        if np.isfinite([wide_a, wide_b, narrow_a, narrow_b]).all():
            off = abs(a - b)
            pairs.append((bool(off <= np.hypot(wide_a, wide_b)), bool(off <= np.hypot(narrow_a, narrow_b))))
    return pairs


def _sources() -> list[str]:
    return sorted({one.name.partition("/")[0] for one in inputs() if one.measured})


STUDY = Study(
    name="held_out",
    title="Measurements held out",
    claim=(
        "Of random halves held out, 95 % bands cover 90 to 98 % on 80 % of tables, with at most half the "
        "interval score of relative noise and a floor; of every second scan held out they cover at least "
        "90 % on 80 % of tables, with a lower score than theirs; fits to disjoint scans agree within their "
        "robust 95 % intervals in 90 % of the parameters of tables with ten scans or more. "
        "(independent: how many agree where residuals are taken as independent)"
    ),
    columns=(
        "tables", "random: cover", "random: within", "random: brightest", "random: score", "scans: cover",
        "scans: within", "scans: brightest", "scans: score", "halves agree", "independent", "pairs",
    ),
    models=_sources,
    judge=judge,
    subject="source",
)
