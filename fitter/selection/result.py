"""Selection: models compared on one table, which of them was chosen, and whether any is good enough."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from fitter.documents import write_document
from fitter.fitting.result import FitResult
from fitter.selection.candidates import Skipped
from fitter.selection.compare import Difference
from fitter.spec import SelectionSpec

KIND = "brdf-fitter/selection"
Verdict = Literal["model", "raw_table", "not_judged"]


@dataclass(frozen=True)
class Ranked:
    """One model of the ranking.

    error : root mean square residual in the metric, geometric mean over the folds; of held-out samples, or of
        fitted ones where ``held_out`` is False: then the held-out error is at least this.
    relative_error : median of |f - y|/(|y| + 1 % of the median), of the same samples.
    against_best : error over that of the best held-out model, with its uncertainty; None where not held out.
    as_good : whether that difference is within one standard error (or below 1 %).
    information_criterion : BIC with the effective number of values, less the smallest one of the ranking.
    """

    model: str
    parameters: int
    error: float
    relative_error: float
    held_out: bool
    errors_by_fold: tuple[float, ...]
    against_best: Difference | None
    as_good: bool
    information_criterion: float
    status: str
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        found = self.against_best
        return {
            "model": self.model, "parameters": self.parameters, "error": self.error,
            "relative_error": self.relative_error, "held_out": self.held_out,
            "errors_by_fold": list(self.errors_by_fold),
            "against_best": None if found is None else _ratio(found),
            "as_good": self.as_good, "information_criterion": self.information_criterion,
            "status": self.status, "seconds": self.seconds,
        }  # fmt: skip


@dataclass(frozen=True)
class RawTable:
    """How well the table's own interpolant predicts held-out samples, and the chosen model the same ones.

    error : as of a model. model_over_raw : the ratio of the two errors. words : what was predicted from what.
    """

    error: float
    relative_error: float
    relative_error_of_model: float
    model_over_raw: Difference
    samples: int
    words: str

    def to_dict(self) -> dict[str, Any]:
        return {
            "error": self.error, "relative_error": self.relative_error,
            "relative_error_of_model": self.relative_error_of_model,
            "model_over_raw": _ratio(self.model_over_raw), "samples": self.samples, "words": self.words,
        }  # fmt: skip


@dataclass(frozen=True)
class Selection:
    """What comparing models found.

    fits : of the chosen model, first, and of the next best ones, on the whole table. Each holds this
        comparison, without the fits, as ``evidence["selection"]``.
    ranking : every model that the table supports; those compared on held-out samples first, best first.
    not_candidates : models that were not tried or that the table does not support, and why.
    method : "cross_validation", or "information_criterion" where nothing can be held out.
    folds : how samples were held out. raw : None where the table could not be held out like a model, then
        ``raw_reason`` says why.
    verdict : "model", "raw_table" where no model is good enough, "not_judged" where that can't be said.
    sentences : the choice, the verdict and what limits them, for people.
    """

    spec: SelectionSpec
    fits: tuple[FitResult, ...]
    ranking: tuple[Ranked, ...]
    not_candidates: tuple[Skipped, ...]
    method: Literal["cross_validation", "information_criterion"]
    folds: Mapping[str, Any]
    raw: RawTable | None
    raw_reason: str | None
    noise_ratio: float | None
    verdict: Verdict
    sentences: tuple[str, ...]
    cost: Mapping[str, Any]

    @property
    def chosen(self) -> FitResult:
        return self.fits[0]

    def summary(self) -> dict[str, Any]:
        """JSON-ready: everything but the fits."""
        return {
            "kind": KIND, "version": 1, "chosen": self.chosen.spec.model.name, "verdict": self.verdict,
            "sentences": list(self.sentences), "method": self.method, "folds": dict(self.folds),
            "ranking": [one.to_dict() for one in self.ranking],
            "not_candidates": [{"model": one.model, "reason": one.reason} for one in self.not_candidates],
            "raw_table": None if self.raw is None else self.raw.to_dict(),
            "raw_table_reason": self.raw_reason, "noise_ratio": self.noise_ratio,
            "spec": self.spec.model_dump(mode="json"), "cost": dict(self.cost),
        }  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready: the comparison and the fits."""
        return {**self.summary(), "fits": [fit.to_dict() for fit in self.fits]}

    def save(self, path: Path | str) -> None:
        """Write the comparison, without the fits, as JSON, aside and renamed."""
        write_document(self.summary(), Path(path))

    def with_evidence(self) -> Selection:
        """The same, each fit knowing of the comparison that it comes from."""
        summary = self.summary()
        fits = [replace(fit, evidence={**fit.evidence, "selection": summary}) for fit in self.fits]
        if self.verdict == "raw_table":
            fits[0] = replace(fits[0], warnings=(*fits[0].warnings, _uncapitalised(self.sentences[1])))
        return replace(self, fits=tuple(fits))


def _ratio(found: Difference) -> dict[str, float]:
    return {
        "ratio": found.ratio, "log_standard_error": found.log_error, "lower_95": found.lower,
        "upper_95": found.upper,
    }  # fmt: skip


def _uncapitalised(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:].rstrip(".")
