"""select: fit the candidates, hold out scans, rank, choose, and say whether any model is good enough."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fitter import directions
from fitter.compression import CompressedTable
from fitter.errors import FitError, SpecError
from fitter.fitting import FitResult, fit
from fitter.progress import Cancelled, Progress, ignore
from fitter.quality.measured import features
from fitter.selection import candidates, words
from fitter.selection.blocks import azimuths
from fitter.selection.candidates import Skipped
from fitter.selection.compare import (
    NO_EVIDENCE,
    TOLERATED,
    as_good,
    difference,
    effective_samples,
    information_criterion,
    score,
)
from fitter.selection.data import Data
from fitter.selection.raw import RawPrediction, raw_prediction, repeatability
from fitter.selection.result import Ranked, RawTable, Selection
from fitter.selection.trial import Trial, cross_validated, fitted, request
from fitter.spec import ModelSpec, SelectionSpec, selection_spec
from fitter.table import Table

#: Fits on the whole table: the chosen model's and the next best ones'.
KEPT = 3
#: Shares of the progress: fits to all samples, folds, and the fits to the whole table.
_FITS, _FOLDS = 0.4, 0.9


def select(
    table: Table | CompressedTable,
    spec: SelectionSpec | None = None,
    *,
    progress: Progress = ignore,
    **settings: Any,
) -> Selection:
    """Compare models on a table and choose the simplest one that predicts held-out scans as well as the best.

    Parameters
    ----------
    spec : what to compare and how; or the fields of a SelectionSpec by keyword (``candidates``, ``metric``,
        ``folds``, ``select``, ``seed``, ...), candidates also by their short names.
    progress : called with (share, text); may raise to stop the work.

    Raises
    ------
    SpecError : the request makes no sense for this table, or a named candidate can't be fitted.
    FitError : nothing usable to fit, or the table supports none of the candidates ("no-candidate").
    """
    begin = time.perf_counter()
    wanted = selection_spec(settings) if spec is None else spec
    whole = table.decompress() if isinstance(table, CompressedTable) else table
    progress(0.0, "dealing scans into folds")
    data = Data.of(whole, wanted)
    run = _Run(data, wanted, progress, begin)
    run.try_all()
    clock = {"fits": time.perf_counter() - begin}
    prediction = raw_prediction(data)
    raw = None if isinstance(prediction, str) else prediction
    clock["raw table"] = time.perf_counter() - begin - sum(clock.values())
    if data.blocks.kind is not None:
        run.hold_out(raw)
    clock["folds"] = time.perf_counter() - begin - sum(clock.values())
    ranking, order = _ranked(data, run.trials)
    chosen = _chosen(ranking)
    kept = [order[chosen], *(trial for k, trial in enumerate(order) if k != chosen)][:KEPT]
    fits: list[FitResult] = []
    for k, trial in enumerate(kept):
        share = _FOLDS + (1.0 - _FOLDS) * k / len(kept)
        progress(share, f"{trial.name}: fitting the whole table")
        # The chosen model's is the fit that one would get by its name.
        if k == 0 or not data.whole or isinstance(table, CompressedTable):
            fits.append(fit(table, request(trial.fit.spec.model, wanted, wanted.subset)))
        else:
            fits.append(trial.fit)
    clock["whole table"] = time.perf_counter() - begin - sum(clock.values())
    against = None if raw is None else _against_raw(data, raw, order[chosen])
    noise = _noise_ratio(data, order[chosen])
    facts = words.Facts(
        data, ranking, ranking[chosen], against, prediction if isinstance(prediction, str) else None, noise
    )
    progress(1.0, "done")
    return Selection(
        spec=wanted,
        fits=tuple(fits),
        ranking=tuple(ranking),
        not_candidates=tuple(run.skipped),
        method="cross_validation" if data.blocks.kind else "information_criterion",
        folds={
            "kind": data.blocks.kind, "words": data.blocks.words, "folds": data.blocks.folds,
            "blocks": data.blocks.count, "samples": len(data.rows), "of": len(data.used),
        },
        raw=against,
        raw_reason=facts.raw_reason,
        noise_ratio=noise,
        verdict=words.verdict(facts),
        sentences=words.sentences(facts),
        cost={
            "seconds": time.perf_counter() - begin, "phases": clock, "fits": run.fits,
            "budget_seconds": wanted.budget_seconds,
        },
    ).with_evidence()  # fmt: skip


class _Run:
    """The trials of a comparison, one after the other."""

    def __init__(self, data: Data, spec: SelectionSpec, progress: Progress, begin: float) -> None:
        self.trials: list[Trial] = []
        self.skipped: list[Skipped] = []
        self.fits = 0
        self._data, self._spec, self._progress, self._begin = data, spec, progress, begin
        self._tried: dict[str, float | None] = {}

    def try_all(self) -> None:
        """Fit the candidates to all samples. Raises FitError where the table supports none of them."""
        named = self._spec.candidates
        if named is not None:
            self._try(list(named), len(named))
        else:
            stages = candidates.stages(_azimuths(self._data))
            most = len(candidates.PLAIN) + 8
            for stage in stages:
                names, skipped = stage(self._tried)
                self.skipped += skipped
                self._try([candidates.model(name) for name in names], most)
        self._some()

    def _try(self, models: list[ModelSpec], most: int) -> None:
        for model in models:
            name = model.name
            if self.trials and self._over_budget():
                self._skip(name, f"not tried: the {self._spec.budget_seconds:g} s were spent")
                continue
            share = _FITS * min(len(self._tried) / most, 1.0)
            trial = self._guarded(
                name, lambda step, m=model: fitted(self._data, m, self._spec, step), share, 0.0
            )
            self._tried[name] = None
            if trial is None:
                continue
            self.fits += 1
            if trial.fit.status != "converged":
                self._skip(name, trial.fit.message)
                continue
            self._tried[name] = trial.error
            self.trials.append(trial)

    def hold_out(self, raw: RawPrediction | None) -> None:
        """Cross-validate the trials, best fit first, those that may still be as good as the best."""
        self.trials.sort(key=lambda trial: trial.error)
        done: list[Trial] = []
        left: list[Trial] = []
        for k, trial in enumerate(self.trials):
            best = min((one.error for one in done), default=np.inf)
            if trial.error > (1.0 + TOLERATED) * best or (done and self._over_budget()):
                left.append(trial)
                continue
            width = (_FOLDS - _FITS) / len(self.trials)
            share = _FITS + width * k
            found = self._guarded(
                trial.name,
                lambda step, t=trial: cross_validated(self._data, t, raw, self._spec, step), share, width,
            )  # fmt: skip
            if found is not None:
                self.fits += self._data.blocks.folds
                done.append(found)
        self.trials = done + left
        self._some()

    def _some(self) -> None:
        if not self.trials:
            why = "; ".join(f"{one.model}: {one.reason}" for one in self.skipped)
            raise FitError(
                "the table supports none of the models", code="no-candidate", cause=why,
                remedy="measure more geometries, or fit one model by its name to see what it makes of them",
            )  # fmt: skip

    def _guarded(
        self, name: str, work: Callable[[Progress], Trial], share: float, width: float
    ) -> Trial | None:
        """The outcome of ``work``, or None where it failed: then the model is no candidate."""

        def step(done: float, what: str) -> None:
            self._progress(share + width * done, what if what.startswith(name) else f"{name}: {what}")

        try:
            return work(step)
        except Cancelled:
            raise
        except FitError as error:
            self._skip(name, error.message)
        except SpecError as error:
            if self._spec.candidates is not None:
                raise
            self._skip(name, error.message)
        return None

    def _skip(self, name: str, reason: str) -> None:
        self.skipped.append(Skipped(name, reason))

    def _over_budget(self) -> bool:
        budget = self._spec.budget_seconds
        return budget is not None and time.perf_counter() - self._begin > budget


def _azimuths(data: Data) -> int:
    """How many incident azimuths a table has that tells anisotropic surfaces apart, half turns the same."""
    if data.table.symmetry == "isotropic":
        return 1
    theta, phi = directions.spherical_from_vector(data.used.pair[:3].T)
    return len(set(azimuths(theta, np.mod(phi, np.pi)).tolist()) - {0})


def _ranked(data: Data, trials: list[Trial]) -> tuple[list[Ranked], list[Trial]]:
    """The ranking and the trials in the same order."""
    least = min(trials, key=lambda trial: float(np.mean(np.square(trial.residuals))))
    wi, wo = data.directions(data.rows)
    isotropic = data.table.symmetry == "isotropic"
    worth = effective_samples(least.residuals, features(wi, wo, isotropic=isotropic), data.seed)
    values = worth * len(data.channels)

    def criterion(trial: Trial) -> float:
        error = max(float(np.sqrt(np.mean(np.square(trial.residuals)))), data.exact)
        return information_criterion(error, trial.parameters, values)

    smallest = min(criterion(trial) for trial in trials)
    compared = [trial for trial in trials if trial.held_out is not None]
    key: Mapping[bool, Callable[[Trial], Any]] = {
        True: lambda trial: (trial.held_out is None, trial.error), False: criterion
    }
    order = sorted(trials, key=key[bool(compared)])
    best = min(compared, key=lambda trial: trial.error, default=None)
    ranking: list[Ranked] = []
    for trial in order:
        delta = criterion(trial) - smallest
        against, same = None, False
        if trial.held_out is not None and best is not None and best.held_out is not None:
            against = difference(trial.held_out, best.held_out)
            same = as_good(against)
        elif best is None:
            same = delta <= NO_EVIDENCE
        errors = trial.fitted if trial.held_out is None else trial.held_out
        ranking.append(
            Ranked(
                trial.name, trial.parameters, trial.error, trial.relative, trial.held_out is not None,
                tuple(errors.tolist()), against, same, delta, trial.fit.status, trial.seconds,
            )
        )  # fmt: skip
    return ranking, order


def _chosen(ranking: list[Ranked]) -> int:
    """Of the models as good as the best the one with the fewest parameters, the better one of equals."""
    good = [k for k, one in enumerate(ranking) if one.as_good]
    return min(good, key=lambda k: (ranking[k].parameters, k))


def _against_raw(data: Data, raw: RawPrediction, chosen: Trial) -> RawTable | None:
    if chosen.on_raw is None:
        return None
    errors, judged = raw.errors(data), raw.folds(data)
    return RawTable(
        score(errors[judged]), data.relative(raw.rows, raw.value), chosen.relative_on_raw,
        difference(chosen.on_raw[judged], errors[judged]), len(raw.rows), raw.words,
    )  # fmt: skip


def _noise_ratio(data: Data, chosen: Trial) -> float | None:
    """Error of the chosen model over that of the noise alone, None where the noise is not known."""
    relative = None if data.used.sigma is not None else repeatability(data.table, data.seed)
    noise = data.noise(data.rows, relative)
    return None if noise is None else chosen.error / score(data.errors(data.rows, noise))
