"""What the uncertainties of real tables are worth: measurements held out, and fits to disjoint halves.

Bands of new measurements (:func:`fitter.posterior.predictive`) of fits to random halves of a table, and to
every second scan, are held against the other half, beside bands of relative noise and a floor, which know no
correlation. What is said of a table is the mean over its splits; a fit that says of itself that it did not
converge or is not identified promises nothing, and is counted ("disowned"). Fits to the even and to the odd
scans are compared by their robust intervals and by those that take residuals as independent. Needs the
measured tables (BRDF_SHARED).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

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
#: Random halvings; each half is held out once.
HALVINGS = 2
#: In its own channel only: channels of a table share their misfit.
CHANNEL = 0


def judge(name: str, share: float, seed: int) -> Outcome:
    rows: dict[str, list[dict[str, float]]] = defaultdict(list)
    agree: list[tuple[bool, bool]] = []
    disowned = 0
    tables = list(_tables(name))
    for table in tables[: max(1, round(len(tables) * share))]:
        rng = np.random.default_rng(seed)
        whole = _part(table, np.sort(rng.permutation(np.flatnonzero(table.mask))[:SAMPLES]))
        scan = blocks(whole.wi, whole.wo, 6, isotropic=True)
        halves = [rng.permutation(len(whole)) < len(whole) // 2 for _ in range(HALVINGS)]
        even = scan.block % 2 == 0
        for model in MODELS:
            kinds = [("random", halves)] + [("scans", [even])] * (scan.kind is not None)
            for kind, splits in kinds:
                new = "scans" if kind == "scans" else "directions"
                held, refused = _held(whole, splits, model, new, seed)
                rows[kind] += held
                disowned += refused
            if scan.kind is None:
                continue
            if scan.count >= ENOUGH_SCANS:
                agree += _agreement(whole, even, model)
    figures: dict[str, Any] = {"tables": len(tables), "disowned": disowned}
    violations: list[dict[str, Any]] = []
    for kind, found in rows.items():
        if not found:
            continue
        mean = {key: np.mean([row[key] for row in found], axis=0) for key in found[0]}
        cover = np.array([row["cover"] for row in found])
        low, high = (0.9, 0.98) if kind == "random" else (0.9, 1.0)
        well = float(np.mean((cover >= low) & (cover <= high)))
        score = float(mean["score"])
        figures |= {
            f"{kind}: cover": float(mean["cover"]), f"{kind}: naive": float(mean["naive"]),
            f"{kind}: within": well, f"{kind}: score": score, f"{kind}: seen": float(mean["seen"]),
            f"{kind}: brightest": float(mean["bright"]),
            f"{kind}: thirds": " ".join(f"{third:.2f}" for third in mean["thirds"]),
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


def _held(
    whole: Table, halves: list[BoolArray], model: str, new: Literal["directions", "scans"], seed: int
) -> tuple[list[dict[str, Any]], int]:
    """How the bands of fits to each half, and to what it leaves, hold the rest: one mean over the splits, of
    which those are left out, and counted, whose fit says of itself that it is none."""
    rows: list[list[float]] = []
    disowned = 0
    for used in (part for half in halves for part in (half, ~half)):
        part = _part(whole, np.flatnonzero(used))
        fit = fitter.fit(part, model)
        if fit.status != "converged":
            disowned += 1
            continue
        found = predictive(part, fit, robust(part, fit), seed)
        wi, wo, y = whole.wi[~used], whole.wo[~used], whole.value[~used]
        lower, upper = found.predict(wi, wo, new=new if new in found.processes else "directions")
        f = np.asarray(fit.model.evaluate(wi, wo))
        r, e = _relative_and_floor(part, fit)
        plain = 1.96 * np.hypot(r * f, e)
        below, above = f - plain, f + plain
        inside, bright = (y >= lower) & (y <= upper), y >= np.quantile(y, 0.95)
        seen = y <= part.value.max()
        # From the peak down.
        third = np.array_split(inside[np.argsort(-f[:, 0])], 3)
        rows.append(
            [
                float(inside.mean()), float(((y >= below) & (y <= above)).mean()),
                float(inside[bright].mean()),
                _score(lower, upper, y), _score(below, above, y),
                _score(lower[seen], upper[seen], y[seen]), _score(below[seen], above[seen], y[seen]),
                *(float(t.mean()) for t in third),
            ]
        )  # fmt: skip
    if not rows:
        return [], disowned
    cover, naive, bright, ours, theirs, ours_seen, theirs_seen, *thirds = np.mean(rows, axis=0).tolist()
    return [
        {
            "cover": cover, "naive": naive, "bright": bright, "score": ours / theirs,
            "seen": ours_seen / theirs_seen, "thirds": thirds,
        }
    ], disowned  # fmt: skip


def _relative_and_floor(part: Table, fit: fitter.FitResult) -> tuple[float, float]:
    """r and e of noise sqrt((r f)^2 + e^2), by maximum likelihood of independent normal residuals."""
    f = np.asarray(fit.model.evaluate(part.wi, part.wo))[:, CHANNEL]
    residual, typical = part.value[:, 0] - f, float(np.median(np.abs(f)))

    def loss(logs: FloatArray) -> float:
        variance = np.square(np.exp(logs[0]) * f) + np.square(np.exp(logs[1]) * typical)
        return float(np.mean(np.square(residual) / variance + np.log(variance)))

    starts = np.log([[0.3, 0.1], [1.0, 1e-3], [0.01, 1.0]])
    found = min((minimize(loss, start, method="Nelder-Mead") for start in starts), key=lambda one: one.fun)
    return float(np.exp(found.x[0])), float(np.exp(found.x[1]) * typical)


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
        "(disowned: fits that say of themselves that they did not converge or are not identified, left out; "
        "naive: coverage of relative noise and a floor; seen: the score of those no brighter than "
        "the brightest that was fitted; thirds: of ours where the model is brightest, "
        "in between, and darkest; independent: how many agree where residuals are taken as "
        "independent)"
    ),
    columns=(
        "tables",
        "disowned",
        *(
            f"{kind}: {what}"
            for kind in ("random", "scans")
            for what in ("cover", "naive", "within", "score", "seen", "brightest", "thirds")
        ),
        "halves agree",
        "independent",
        "pairs",
    ),
    models=_sources,
    judge=judge,
    subject="source",
)
