"""Trial: one model on its way through a comparison, fitted to all samples and then to all but a fold."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitter.fitting import FitResult, fit
from fitter.models.padded import evaluated
from fitter.progress import Progress
from fitter.selection.compare import score
from fitter.selection.data import Data, held_out
from fitter.selection.raw import RawPrediction
from fitter.spec import FitSpec, ModelSpec, SelectionSpec

FloatArray = NDArray[np.float64]

#: Samples that the searches of a comparison look at. Few, and the same number for every fold and table, so
#: that one compiled program a model serves them all.
SEARCHED = 1024


@dataclass(frozen=True)
class Trial:
    """A model that the table supports.

    fitted : (K,) errors by fold of the fit to all samples; held_out : (K,) of fits that had not seen the
    fold; on_raw : (K,) the same on the samples that the raw table predicts. relative, relative_on_raw : the
    median relative error, of held-out samples as soon as there are any.
    """

    fit: FitResult
    fitted: FloatArray
    residuals: FloatArray
    relative: float
    seconds: float
    held_out: FloatArray | None = None
    on_raw: FloatArray | None = None
    relative_on_raw: float = float("nan")

    @property
    def name(self) -> str:
        return self.fit.spec.model.name

    @property
    def parameters(self) -> int:
        return len(self.fit.labels)

    @property
    def error(self) -> float:
        """The held-out error, or where there is none the fitted one, which is no larger.

        The fit to all minimises the sum of squares S, the other one S - S_k, without fold k. So in S_k = S -
        (S - S_k) the other one has the larger S and the smaller S - S_k: never a smaller S_k.
        """
        return score(self.fitted if self.held_out is None else self.held_out)


def fitted(data: Data, model: ModelSpec, spec: SelectionSpec, progress: Progress) -> Trial:
    """The model fitted to all compared samples. Raises SpecError or FitError."""
    begin = time.perf_counter()
    if data.whole:
        found = fit(data.table, request(model, spec, min(spec.subset, SEARCHED)), progress=progress)
    else:
        found = fit(data.part(data.rows), _of_part(data, model, spec), progress=progress)
    predicted = evaluated(found.model, *data.directions(data.rows))
    residuals = data.residuals(data.rows, predicted)
    return Trial(
        found, data.errors(data.rows, residuals), residuals, data.relative(data.rows, predicted),
        time.perf_counter() - begin,
    )  # fmt: skip


def cross_validated(
    data: Data, trial: Trial, raw: RawPrediction | None, spec: SelectionSpec, progress: Progress
) -> Trial:
    """The trial with the errors of each fold under the fit to the other folds. Raises FitError."""
    begin = time.perf_counter()
    model, folds = trial.fit.spec.model, data.blocks.folds
    predicted = np.empty((len(data.rows), len(data.channels)))
    at_raw = np.empty((0 if raw is None else len(raw.rows), len(data.channels)))
    fold, fold_of_raw = data.fold, data.blocks.fold[[] if raw is None else raw.rows]
    for k in range(folds):
        progress(k / folds, f"{trial.name}: fold {k + 1} of {folds}")
        others, _ = held_out(data, k)

        def step(share: float, what: str, k: int = k) -> None:
            progress((k + share) / folds, f"{trial.name}: fold {k + 1} of {folds}: {what}")

        found = fit(data.part(others), _of_part(data, model, spec), progress=step).model
        # At all of them, not at the fold's own: one length, one program.
        predicted[fold == k] = evaluated(found, *data.directions(data.rows))[fold == k]
        if raw is not None:
            mine = fold_of_raw == k
            at_raw[mine] = evaluated(found, *data.directions(raw.rows))[mine]
    return replace(
        trial,
        held_out=data.errors(data.rows, data.residuals(data.rows, predicted)),
        on_raw=None if raw is None else data.errors(raw.rows, data.residuals(raw.rows, at_raw)),
        relative_on_raw=float("nan") if raw is None else data.relative(raw.rows, at_raw),
        relative=data.relative(data.rows, predicted),
        seconds=trial.seconds + time.perf_counter() - begin,
    )


def request(model: ModelSpec, spec: SelectionSpec, subset: int) -> FitSpec:
    """The fit of a model to the whole table, its search on ``subset`` samples."""
    return FitSpec(
        model=model, metric=spec.metric, solver=spec.solver, select=spec.select, starts=spec.starts,
        subset=subset, seed=spec.seed,
    )  # fmt: skip


def _of_part(data: Data, model: ModelSpec, spec: SelectionSpec) -> FitSpec:
    """The fit to a part of the samples, which are selected already."""
    return FitSpec(
        model=model, metric=data.metric, solver=spec.solver, starts=spec.starts,
        subset=min(spec.subset, SEARCHED), seed=spec.seed,
    )  # fmt: skip
