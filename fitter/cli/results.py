"""Results as the command writes, reads and shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitter.cli.screen import Screen, file_size, number
from fitter.errors import SpecError

if TYPE_CHECKING:
    from fitter.fitting import FitResult


def load_result(path: str | Path, model: str | None = None) -> FitResult:
    """The one fit in a file, or the one of ``model`` where it holds several."""
    from fitter.fitting.result import load_fits
    from fitter.spec import ModelSpec

    results = load_fits(path)
    if model is not None:
        wanted = ModelSpec.parse(model).name
        results = [result for result in results if result.spec.model.name == wanted]
    if len(results) == 1:
        return results[0]
    names = ", ".join(result.spec.model.name for result in load_fits(path))
    raise SpecError(
        f"the file holds fits of {names}, and one is needed", code="which-fit", file=str(path),
        parameter="model", remedy="name one with --model",
    )  # fmt: skip


def fits_document(
    fits: Sequence[Mapping[str, Any]], failures: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """What ``fit --json`` prints: the one fit, or the one failure, or all of them."""
    from fitter.documents import FITS

    if len(fits) == 1 and not failures:
        return dict(fits[0])
    if len(failures) == 1 and not fits:
        return {"error": failures[0]["error"]}
    return {"kind": FITS, "fits": list(fits), "failures": list(failures)}


def show_fit(result: FitResult, screen: Screen) -> None:
    """The fitted parameters with their standard uncertainties, and how good and dear the fit was."""
    channels = result.model.channels
    screen.line(f"{result.spec.model.name}: {result.status.replace('_', ' ')} in {result.seconds:.2f} s")
    if result.status != "converged" or result.evidence.get("selection_error"):
        screen.line(f"  {result.message}")
    metrics = ", ".join(f"{name.replace('_', ' ')} {number(value)}" for name, value in result.metrics.items())
    screen.line(f"  {metrics}")
    rows: list[list[str]] = []
    for name, estimate in result.parameters.items():
        values, spreads = estimate.value.reshape(-1), estimate.standard_uncertainty.reshape(-1)
        freedom = estimate.degrees_of_freedom.reshape(-1).tolist()
        for k, (value, spread) in enumerate(zip(values.tolist(), spreads.tolist(), strict=True)):
            channel = channels[k] if estimate.value.ndim else ""
            bound = estimate.at_bound[k] if k < len(estimate.at_bound) else None
            rows.append(
                [
                    f"{name}[{channel}]" if channel else name,
                    number(value),
                    "-" if spread != spread else number(spread, 2),
                    "-" if spread != spread else "∞" if math.isinf(freedom[k]) else f"{freedom[k]:.0f}",
                    estimate.unit,
                    (f"at its {bound} bound; " if bound else "") + estimate.description,
                ]
            )
    screen.table(("parameter", "estimate", "u (k=1)", "ν", "unit", ""), rows)
    screen.line(f"  cost: {cost_in_words(result)}")
    told = result.cost.get("budget")
    if told is not None:
        for text in (told["sentence"], told["ten_times"]["sentence"], *told["notes"]):
            screen.line(f"  budget: {text}")
    for warning in result.warnings:
        screen.line(f"  warning: {warning}")


def cost_in_words(result: FitResult) -> str:
    """Seconds of each phase that took any, passes over the data, and memory."""
    cost = result.cost
    phases: Mapping[str, float] = cost.get("phases", {})
    parts = [f"{name} {number(spent, 2)} s" for name, spent in phases.items() if spent >= 5e-4]
    parts.append(f"{cost.get('passes', 0)} passes over {number(cost.get('samples'))} samples")
    growth, peak = cost.get("memory_growth_bytes"), cost.get("peak_memory_bytes")
    if peak is not None:
        grown = "" if growth is None else f", {file_size(growth)} of it during the fit"
        parts.append(f"memory {file_size(peak)} at the peak{grown}")
    return ", ".join(parts)
