"""Budgets: a fit in so many seconds, or with at most so much search error.

The search error is by what share the rms residual is above that of the same model's optimum on the same
table. The model's own misfit is another thing: no search mends it, and it is reported beside.

The cost model of the machine (:mod:`fitter.fitting.cost_model`) says what each effort will take, compiling
included. A budget gets the best effort that fits into it, a target the cheapest that reaches it. What can't
be had is a FitError "unattainable", before anything is fitted.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from fitter import progress
from fitter.compression import CompressedTable
from fitter.errors import FitError
from fitter.fitting import calibration, cost_model, reduction
from fitter.fitting.compiling import compiled_here
from fitter.fitting.cost_model import Book, Prediction
from fitter.fitting.effort import Case, Effort
from fitter.fitting.layout import Layout
from fitter.fitting.result import FitResult
from fitter.fitting.samples import Usable
from fitter.spec import FitSpec
from fitter.table import Table

Engine: TypeAlias = Callable[[Table | CompressedTable, FitSpec, progress.Progress], FitResult]
Options: TypeAlias = Sequence[tuple[Effort, Prediction]]
#: By how much a budget may be overrun, and a result still be called in time.
GRACE = 1.5


@dataclass(frozen=True)
class Choice:
    """The effort chosen, what it was predicted to take, and all that there was to choose from."""

    effort: Effort
    prediction: Prediction
    options: Options


def fit_within(
    table: Table | CompressedTable, request: FitSpec, run: Engine, report: progress.Progress
) -> FitResult:
    """The fit that keeps the request's ``budget_seconds`` and ``target_error``; ``run`` makes a fit of stated
    effort. ``cost["budget"]`` of the result says what was asked, chosen, predicted and measured.

    Raises
    ------
    FitError : "unattainable", or what ``run`` raises. SpecError : the request makes no sense.
    """
    begun = time.perf_counter()
    case = Case.of(table, request)
    _check_target(case, request)
    book, notes, calibrating = opened(run, report)
    choice = choose(book, case, request)
    deciding = time.perf_counter() - begun - calibrating
    result = run(table, choice.effort.applied(request), report)
    book = learned(book, case, choice.effort, result, deciding)
    error = float(result.evidence["search_error"])
    target = request.target_error
    if target is not None and error > target and not case.complete(choice.effort):
        # The subset was worse than subsets of such tables are: the whole table has the word.
        notes.append(f"the search error after the subset was {error:.2g}, above the target: polished on")
        effort = replace(choice.effort, polish="full")
        result = run(table, effort.applied(request), report)
        book = learned(book, case, effort, result)
        choice = replace(choice, effort=effort)
    # Calibrating happens once on a machine; the budget is of the fit.
    seconds = time.perf_counter() - begun - calibrating
    notes += cost_model.save(book, cost_model.path())
    account = _account(book, case, request, choice, result, seconds)
    account |= {"calibration_seconds": calibrating, "notes": notes}
    over = request.budget_seconds is not None and seconds > GRACE * request.budget_seconds
    late = (f"the budget of {spoken(request.budget_seconds or 0)} was overrun: {spoken(seconds)}",)
    return replace(
        result,
        cost={**result.cost, "budget": account},
        warnings=(*result.warnings, *(late if over else ())),
    )


def opened(run: Engine, report: progress.Progress) -> tuple[Book, list[str], float]:
    """The cost model of this machine, notes on it, and the seconds that calibrating it took just now."""
    book, notes = cost_model.load(cost_model.path())
    if book is not None:
        return book, notes, 0.0
    begun = time.perf_counter()
    found = calibration.calibrate(run, report)
    spent = time.perf_counter() - begun
    return Book(machine=cost_model.machine(), calibration=found), notes, spent


def choose(book: Book, case: Case, request: FitSpec) -> Choice:
    """The best effort within the budget, or the cheapest that reaches the target. Raises FitError."""
    efforts = case.efforts(request.starts)
    options = list(zip(efforts, cost_model.predictions(book, case, efforts), strict=True))
    name = request.model.name
    target, budget = request.target_error, request.budget_seconds
    good = options
    if target is not None:
        enough = request.starts or case.usual_starts
        good = [(e, p) for e, p in options if p.error <= target and e.starts >= enough]
    if budget is None:
        return Choice(*min(good, key=lambda option: option[1].seconds), options)
    sure = [(e, p) for e, p in good if p.seconds * _margin(p) <= budget]
    if sure and target is not None:
        return Choice(*min(sure, key=lambda option: option[1].seconds), options)
    if sure:
        return Choice(*min(sure, key=lambda option: case.score(option[0], option[1].error)), options)
    effort, cheapest = min(good, key=lambda option: option[1].seconds)
    if cheapest.running / cheapest.factor + cheapest.compiling / cheapest.factor > budget:
        what = "the cheapest fit" if target is None else f"a fit to within {target:.2g}"
        compiling = f", {spoken(cheapest.compiling)} of it compiling" if cheapest.compiling > 0 else ""
        raise FitError(
            f"a budget of {spoken(budget)} is unattainable: {what} of {name} to this table takes about "
            f"{spoken(cheapest.seconds)} on this machine{compiling}",
            code="unattainable", parameter="budget_seconds",
            cause="compiling, which happens once a process" if 2 * cheapest.compiling > cheapest.seconds
            else "the table has to be prepared and searched at least once",
            remedy=f"give it {spoken(cheapest.seconds * _margin(cheapest))} or more",
        )  # fmt: skip
    return Choice(effort, cheapest, options)


def _check_target(case: Case, request: FitSpec) -> None:
    """Raise FitError for a target that no effort reaches: it takes no cost model to know that."""
    least = min(case.error(effort) for effort in case.efforts(request.starts))
    target = request.target_error
    if target is not None and target < least:
        raise FitError(
            f"a search error of {target:.2g} is unattainable: the passes over this table stop within "
            f"{least:.1g} of the optimum of {request.model.name}",
            code="unattainable", parameter="target_error",
            cause="it is below what the arithmetic and the stopping rule resolve",
            remedy=f"ask for {1.1 * least:.1g} or more",
        )  # fmt: skip


def _margin(prediction: Prediction) -> float:
    """What a budget has to hold for a prediction: what is uncertain within the grace is no concern."""
    return max(1.0, prediction.factor / GRACE)


def remember_compiled(request: FitSpec, places: Layout, data: Usable, channels: int) -> None:
    """Note that the programs of a fit are compiled now."""
    case = _of_fit(request, places, data, channels)
    compiled_here().update(case.programs(case.effort(request)).values())


def _of_fit(request: FitSpec, places: Layout, data: Usable, channels: int) -> Case:
    from fitter.fitting import candidates

    usual = candidates.default_counts(len(places.free))[1]
    reducible = reduction.applies(places, data.metric, data.table, len(data))
    return Case("", places, request.solver, data.metric, len(data), channels, 1, usual, 0, reducible)


def learned(book: Book, case: Case, effort: Effort, result: FitResult, deciding: float = 0.0) -> Book:
    """The cost model that knows this fit, too, and the seconds that choosing it took."""
    cost, fitted = result.cost, int(result.table["fitted"])
    compiled: Mapping[str, float] = cost["compiled_in"]
    search = compiled.get("search", 0.0)
    rest = sum(compiled.values()) - search
    error = float(result.evidence["search_error"])
    whole = case.complete(effort)
    seconds = calibration.by_phase(cost["phases"])
    seconds["check"] += deciding
    run = cost_model.Run(
        key=case.key, samples=fitted, channels=case.channels, subset=min(effort.subset, fitted),
        starts=effort.starts, full=effort.polish == "full", passes=max(1, int(cost["passes"])),
        seconds=seconds,
        # Nothing to compile says nothing of what compiling takes.
        compile_search=search if search > 0 else None, compile_rest=rest if rest > 0 else None,
        cached=bool(cost["from_cache"]),
        spread=None if whole else min(1e9, error / case.independent(effort.subset)),
    )  # fmt: skip
    return cost_model.with_run(book, run, list(case.programs(effort).values()))


def _account(
    book: Book, case: Case, request: FitSpec, choice: Choice, result: FitResult, seconds: float
) -> dict[str, Any]:
    """What the result says of its budget; JSON-ready."""
    error = float(result.evidence["search_error"])
    budget, target = request.budget_seconds, request.target_error
    kept = (budget is None or seconds <= GRACE * budget) and (target is None or error <= target)
    predicted = choice.prediction
    misfit = float(result.metrics["relative_rmse"])
    return {
        "asked": {"budget_seconds": budget, "target_error": target},
        "chosen": choice.effort.to_dict(),
        "predicted": {
            "seconds": predicted.seconds, "compile_seconds": predicted.compiling,
            "within_a_factor": predicted.factor, "search_error": predicted.error,
        },
        "measured": {
            "seconds": seconds, "compile_seconds": float(result.cost["phases"]["compile"]),
            "search_error": error,
        },
        "kept": bool(kept),
        "misfit": misfit,
        "ten_times": _ten_times(book, case, choice, result, seconds),
        "sentence": (
            f"{choice.effort}: {spoken(seconds)}, {spoken(predicted.seconds)} predicted; search error at "
            f"most {error:.1g}. The model itself misses the table by {misfit:.2g} (relative rmse), "
            "which no search mends"
        ),
    }  # fmt: skip


def _ten_times(book: Book, case: Case, choice: Choice, result: FitResult, seconds: float) -> dict[str, Any]:
    """What ten times the seconds would have bought, by the cost model, which knows this fit by now."""
    error = float(result.evidence["search_error"])
    efforts = [effort for effort, _ in choice.options]
    later = zip(efforts, cost_model.predictions(book, case, efforts), strict=True)
    within = [(e, p) for e, p in later if p.seconds <= 10.0 * seconds]
    here = case.score(choice.effort, error)
    best = min(within, key=lambda option: case.score(option[0], option[1].error), default=None)
    if best is not None and best[1].error < 0.5 * error:
        # What a better error costs is what the cheapest effort with such an error costs.
        enough, starts = 2.0 * best[1].error, choice.effort.starts
        alike = [(e, p) for e, p in within if p.error <= enough and e.starts >= starts]
        best = min(alike, key=lambda option: option[1].seconds, default=best)
    if best is None or case.score(best[0], best[1].error) >= here:
        return {
            "effort": None, "seconds": None, "search_error": None,
            "sentence": f"ten times the time ({spoken(10 * seconds)}) would have bought nothing",
        }  # fmt: skip
    effort, prediction = best
    gain = (
        f"a search error of {prediction.error:.1g} instead of {error:.1g}" if prediction.error < 0.5 * error
        else f"more certainty of the best optimum: {effort.starts} starts instead of {choice.effort.starts}"
    )  # fmt: skip
    return {
        "effort": effort.to_dict(), "seconds": prediction.seconds, "search_error": prediction.error,
        "sentence": f"ten times the time would have bought {gain} ({spoken(prediction.seconds)}: {effort})",
    }  # fmt: skip


def spoken(seconds: float) -> str:
    """Seconds for people."""
    if seconds >= 120:
        return f"{seconds / 60:.3g} min"
    return f"{seconds:.2g} s" if seconds >= 1 else f"{1e3 * seconds:.2g} ms"
