"""Robust uncertainties: what u is where the residuals of a scan belong together."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from fitter.report.fitted import Fitted, display
from fitter.report.rounding import at_place_of, rounded, significant

if TYPE_CHECKING:
    from fitter.posterior.jackknife import Robust

METHODS = {
    "jackknife": "from the spread of the estimates when one scan after the other is left out",
    "larger": "as the larger of two, since scans are few: the spread of the estimates when one scan after "
    "the other is left out, and what residuals as correlated over directions as these do to the estimates",
    "correlated": "without scans, which are too few to be left out: from what residuals as correlated over "
    "directions as these do to the estimates",
}


def section(fitted: Fitted, robust: Robust | None) -> dict[str, Any] | None:
    """One row per free parameter, JSON-ready: u as the fit states it beside the robust one, and the 95 %
    interval; None where it was not asked for."""
    if robust is None:
        return None
    fit, channels = fitted.fit, fitted.fit.model.channels
    own = dict(zip(fit.labels, np.sqrt(np.diagonal(fit.covariance)), strict=True))
    rows: list[dict[str, Any]] = []
    for label in robust.labels:
        u, y, plain = robust.standard_uncertainty[label], fitted.estimates[label], float(own[label])
        half = robust.coverage_factor * u
        text = rounded(y, u)
        ends = [at_place_of(y + side * half, u) if math.isfinite(u) else "—" for side in (-1.0, 1.0)]
        rows.append(
            {
                "label": label, "display": display(label, channels), "estimate": y,
                "standard_uncertainty": u, "fit": plain, "ratio": u / plain if plain > 0 else math.nan,
                "lower": y - half, "upper": y + half,
                "rests_on": robust.rests_on[label][1] if label in robust.rests_on else None,
                "text": {
                    "estimate": text.value, "standard_uncertainty": text.uncertainty,
                    "fit": significant(plain, 2), "lower": ends[0], "upper": ends[1],
                },
            }
        )  # fmt: skip
    ratios = [row["ratio"] for row in rows if math.isfinite(row["ratio"])]
    resting = [row["display"] for row in rows if row["rests_on"] is not None]
    return {
        "method": robust.method,
        "method_in_words": METHODS[robust.method],
        "scans": robust.scans,
        "words": robust.words,
        "degrees_of_freedom": robust.degrees_of_freedom,
        "coverage_factor": robust.coverage_factor,
        "effective_samples": dict(zip(channels, robust.effective_samples, strict=True)),
        "median_ratio": float(np.median(ratios)) if ratios else math.nan,
        "resting": resting,
        "rows": rows,
    }
