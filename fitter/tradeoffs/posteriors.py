"""How far the intervals of short posterior runs are from those of a long one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.errors import FitterError
from fitter.fitting.result import FitResult
from fitter.posterior.result import Posterior
from fitter.posterior.run import sample
from fitter.progress import Cancelled
from fitter.spec import PosteriorSpec
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Effective samples that the short runs stop at (the first after the fewest steps there are), and the long
#: one; shares of the time that each may take.
SHORT, LONG = (50, 2000, 4000), 16_000
SHORT_SHARE, LONG_SHARE = 0.1, 0.5
#: So many draws of the shortest run, which are all but independent of each other, show what fewer would give.
FEWER = (100, 400)
LEVEL = 0.95
#: Short runs stop at their number of samples whatever R-hat says: that is what is measured.
LOOSE = 1.2


def measure(
    table: Table, fit: FitResult, seconds: float, seed: int, tell: Callable[[str], None]
) -> dict[str, Any]:
    """JSON-ready: one row a run. ``interval_error`` is the largest distance of an end of a 95 % interval from
    the long run's, in half widths of the long run's interval."""

    def run(ess: int, share: float, turn: int) -> Posterior:
        spec = PosteriorSpec(
            ess=ess, rhat=LOOSE if ess < LONG else 1.01, budget_seconds=max(0.5, share * seconds),
            seed=seed + turn,
        )  # fmt: skip
        return sample(
            table, fit, spec, robust=False,
            progress=lambda _share, _what: tell(f"posterior: {ess} samples"),
        )  # fmt: skip

    try:
        run(SHORT[0], SHORT_SHARE, 0)  # compiles
        found = [run(ess, SHORT_SHARE, turn + 1) for turn, ess in enumerate(SHORT)]
        longest = run(LONG, LONG_SHARE, len(SHORT) + 1)
    except FitterError as error:
        if isinstance(error, Cancelled):
            raise
        return {"model": fit.spec.model.name, "rows": [], "problem": error.to_dict()}
    ends = _ends(longest)
    rows: list[dict[str, Any]] = [
        {
            "wanted_ess": ess, "ess": _smallest(one), "draws": int(one.cost["evaluations"]),
            "seconds": float(one.cost["seconds"]), "status": one.status,
            "interval_error": _distance(_ends(one), ends),
        }
        for ess, one in zip((*SHORT, LONG), (*found, longest), strict=True)
    ]  # fmt: skip
    rows[-1]["interval_error"] = None
    few = [
        {
            **rows[0], "ess": min(float(count), rows[0]["ess"]), "draws": count,
            "interval_error": _distance(_ends(found[0], count), ends),
        }
        for count in FEWER
    ]  # fmt: skip
    rows = few + rows
    return {"model": fit.spec.model.name, "level": LEVEL, "rows": rows, "labels": list(longest.labels)}


def _ends(posterior: Posterior, draws: int | None = None) -> FloatArray:
    """(2, P) ends of the central intervals, of the first ``draws`` only where that is given."""
    tail = 0.5 * (1.0 - LEVEL)
    return np.quantile(posterior.draws[:draws], [tail, 1.0 - tail], axis=0)


def _distance(here: FloatArray, there: FloatArray) -> float | None:
    half = 0.5 * (there[1] - there[0])
    known = half > 0
    return float(np.max(np.abs(here - there)[:, known] / half[known])) if known.any() else None


def _smallest(posterior: Posterior) -> float:
    return float(min(min(d.ess_bulk, d.ess_tail) for d in posterior.diagnostics.values()))
