"""How the model was chosen, where it was chosen by comparison: the ranking that the fit brought along."""

from __future__ import annotations

from typing import Any

from fitter.fitting.result import FitResult


def section(fit: FitResult) -> dict[str, Any] | None:
    """The comparison that the fit comes from, None where its model was named."""
    found = fit.evidence.get("selection")
    if found is None:
        return None
    mine = fit.spec.model.name
    return {
        **{
            name: found[name]
            for name in (
                "chosen", "verdict", "sentences", "method", "folds", "ranking", "raw_table",
                "raw_table_reason", "noise_ratio", "cost",
            )
        },
        "not_candidates": _by_reason(found["not_candidates"]),
        "of_this_fit": next((one for one in found["ranking"] if one["model"] == mine), None),
    }  # fmt: skip


def _by_reason(skipped: list[dict[str, str]]) -> list[dict[str, Any]]:
    """Models that were not compared, those with the same reason together."""
    found: dict[str, list[str]] = {}
    for one in skipped:
        found.setdefault(one["reason"], []).append(one["model"])
    return [{"models": models, "reason": reason} for reason, models in found.items()]
