"""FitResult: the fitted model, its parameters with uncertainties, and what the fit cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import models, spec
from fitter.documents import FITS, finite_or_none, floats, read_document, write_document
from fitter.errors import SpecError
from fitter.student import coverage_factor
from fitter.table import Table

FloatArray = NDArray[np.float64]
KIND = "brdf-fitter/fit"


@dataclass(frozen=True)
class Estimate:
    """One parameter's estimate y and standard uncertainty u (k = 1): () when shared, (C,) per channel.

    ``standard_uncertainty`` is NaN where none can be stated (a fixed parameter, one on a bound, one the
    table does not identify). ``degrees_of_freedom`` are those of u: infinite where the metric is the
    likelihood, otherwise about as many as there are samples that tell the parameter.
    ``at_bound`` says "lower" or "upper" per entry, None when inside.
    """

    value: FloatArray
    standard_uncertainty: FloatArray
    degrees_of_freedom: FloatArray
    unit: str
    description: str
    at_bound: tuple[str | None, ...]

    def expanded_uncertainty(self, level: float = 0.95) -> FloatArray:
        """U = k u that covers with this probability: k of Student's t with the degrees of freedom of u."""
        return np.asarray(coverage_factor(self.degrees_of_freedom, level) * self.standard_uncertainty)

    def to_dict(self) -> dict[str, Any]:
        return {
            "value": self.value.tolist(),
            "standard_uncertainty": finite_or_none(self.standard_uncertainty),
            "degrees_of_freedom": finite_or_none(self.degrees_of_freedom),
            "unit": self.unit,
            "description": self.description,
            "at_bound": list(self.at_bound),
        }


@dataclass(frozen=True)
class FitResult:
    """What a fit found.

    parameters : name -> Estimate, in the order of the model's parameter table.
    labels, covariance : the flat free parameters ("ks[G]", "alpha") and their (P, P) covariance; rows of
        parameters without a stated uncertainty are NaN. ``uncertainty`` names how it was found.
    metrics : "objective" (what was minimised, per usable value), "rmse" (plain, 1/sr), "relative_rmse"
        (of f + the floor 1 % of the median), "r2".
    status : "converged", "not_converged" or "not_identified"; ``message`` says it in a sentence.
    evidence : how the global optimum was looked for: starts, how many agree, the next best basin.
    cost : seconds by phase, passes over the data, samples.
    table : name, hash, samples and usable samples of the table, and how it was reduced.
    """

    spec: spec.FitSpec
    model: models.ReflectanceModel
    parameters: Mapping[str, Estimate]
    labels: tuple[str, ...]
    covariance: FloatArray
    uncertainty: str
    metrics: Mapping[str, float]
    status: str
    message: str
    evidence: Mapping[str, Any]
    cost: Mapping[str, Any]
    table: Mapping[str, Any]
    warnings: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def seconds(self) -> float:
        """Wall time of the whole fit."""
        return float(self.cost["seconds"])

    def columns_of(self, table: Table) -> tuple[int, ...]:
        """The position in a table of each of the model's channels, by name. Raises SpecError where the table
        has not all of them."""
        names = [channel.name for channel in table.channels]
        missing = [name for name in self.model.channels if name not in names]
        if missing:
            raise SpecError(
                f"the fit has a channel {missing[0]!r} and the table has {', '.join(names)}",
                code="table-mismatch", parameter="table",
                cause="the result belongs to another table, or it was read with other options",
                remedy="give the table that was fitted",
            )  # fmt: skip
        return tuple(names.index(name) for name in self.model.channels)

    def to_dict(self) -> dict[str, Any]:
        return {
            "kind": KIND,
            "version": 1,
            "spec": self.spec.model_dump(mode="json"),
            "model": self.model.to_dict(),
            "parameters": {name: e.to_dict() for name, e in self.parameters.items()},
            "covariance": {"labels": list(self.labels), "matrix": finite_or_none(self.covariance)},
            "uncertainty": self.uncertainty,
            "metrics": {name: finite_or_none(np.asarray(v)) for name, v in self.metrics.items()},
            "status": self.status,
            "message": self.message,
            "evidence": dict(self.evidence),
            "cost": dict(self.cost),
            "table": dict(self.table),
            "warnings": list(self.warnings),
            "versions": dict(self.versions),
        }

    @staticmethod
    def from_dict(document: Mapping[str, Any]) -> FitResult:
        """The result that :meth:`to_dict` wrote. Raises SpecError on anything else."""
        try:
            if document["kind"] != KIND:
                raise KeyError(f"kind is {document['kind']!r}, not {KIND!r}")
            return FitResult(
                spec=spec.fit_spec(document["spec"]),
                model=models.from_dict(document["model"]),
                parameters={
                    name: Estimate(
                        floats(e["value"]), floats(e["standard_uncertainty"]), _degrees(e), e["unit"],
                        e["description"], tuple(e["at_bound"]),
                    )
                    for name, e in document["parameters"].items()
                },
                labels=tuple(document["covariance"]["labels"]),
                covariance=floats(document["covariance"]["matrix"]),
                uncertainty=document["uncertainty"],
                metrics={name: float(floats(v)) for name, v in document["metrics"].items()},
                status=document["status"],
                message=document["message"],
                evidence=document["evidence"],
                cost=document["cost"],
                table=document["table"],
                warnings=tuple(document["warnings"]),
                versions=document["versions"],
            )  # fmt: skip
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise SpecError(
                f"this is not a fit result ({error})", code="not-a-fit",
                remedy="give the file that `brdf-fitter fit --out` wrote or `fit --json` printed",
            ) from error  # fmt: skip

    def with_source(self, source: Mapping[str, Any]) -> FitResult:
        """The result, knowing which file its table came from and how that was read."""
        return replace(self, table={**self.table, "source": dict(source)})

    def save(self, path: Path | str) -> None:
        """Write the result as JSON, aside and renamed."""
        write_document(self.to_dict(), Path(path))


def _degrees(estimate: Mapping[str, Any]) -> FloatArray:
    """Degrees of freedom of a document, in which infinity is null, and so are those of no u."""
    u = floats(estimate["standard_uncertainty"])
    found = floats(estimate.get("degrees_of_freedom", np.full(u.shape, np.nan)))
    return np.where(np.isnan(found) & np.isfinite(u), np.inf, found)


def load_fit(path: Path | str) -> FitResult:
    """Read a result that :meth:`FitResult.save` or ``brdf-fitter fit --json`` wrote."""
    return FitResult.from_dict(read_document(Path(path), "not-a-fit"))


def load_fits(path: Path | str) -> list[FitResult]:
    """The fits in a file that ``fit --out`` wrote or ``fit --json`` printed: one, or several."""
    document = read_document(Path(path), "not-a-fit")
    parts = document.get("fits") if document.get("kind") == FITS else [document]
    if not isinstance(parts, list) or not parts:
        raise SpecError("there is no fit in it", code="not-a-fit", file=str(path))
    try:
        return [FitResult.from_dict(part) for part in parts]
    except SpecError as error:
        error.file = error.file or str(path)
        raise


def best(results: Sequence[FitResult]) -> FitResult:
    """The fit with the smallest objective, converged ones first; relative rmse where metrics differ."""
    asked = {(result.table.get("metric"), result.table.get("weighting")) for result in results}
    metric = "objective" if len(asked) == 1 else "relative_rmse"
    return min(results, key=lambda result: (result.status != "converged", result.metrics[metric]))
