"""Posterior: draws, credible intervals, convergence, and where a new measurement would fall."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter import models, spec
from fitter.documents import finite_or_none, floats, read_document, write_document
from fitter.errors import SpecError
from fitter.models.labelled import with_values

FloatArray = NDArray[np.float64]
KIND = "brdf-fitter/posterior"
#: Draws that a prediction uses at most: the quantiles of 400 are good to 1 % of the probability.
PREDICTIVE_DRAWS = 400


@dataclass(frozen=True)
class Diagnostic:
    """Convergence of one parameter, over all walkers of all independent ensembles."""

    rhat: float
    ess_bulk: float
    ess_tail: float
    autocorrelation_time: float

    def to_dict(self) -> dict[str, float | None]:
        return {name: finite_or_none(np.asarray(v)) for name, v in self.__dict__.items()}


@dataclass(frozen=True)
class Posterior:
    """Draws from the posterior of a fit's free parameters under the stated likelihood.

    labels : the flat free parameters ("kd[R]", "alpha"), the noise parameters where inferred, and offsets of
        the instrument's angles in radians where they are sampled.
    draws : (S, P) in the parameters' own units, thinned to about independent.
    template : the fitted model; a draw replaces its free values.
    status : "converged"; "not_converged", and ``message`` which target was missed; "not_identified": a
        parameter fills the range that it was allowed; "prior_conflict": one lies against the bounds of the
        specification.
    uncertainties : "posterior", "naive" and "robust": of each, what it is and u by label, or None
        (:mod:`fitter.posterior.beside`).
    history : list of {"steps", "rhat", "ess", "seconds"} as the run went on.
    """

    spec: spec.PosteriorSpec
    fit_spec: spec.FitSpec
    template: models.ReflectanceModel
    labels: tuple[str, ...]
    draws: FloatArray
    noise: Mapping[str, Any]
    diagnostics: Mapping[str, Diagnostic]
    acceptance: float
    status: str
    message: str
    history: tuple[Mapping[str, float], ...]
    cost: Mapping[str, Any]
    table: Mapping[str, Any]
    uncertainties: Mapping[str, Any] = field(default_factory=dict[str, Any])
    warnings: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        return float(self.cost["seconds"])

    def intervals(self, level: float = 0.95) -> dict[str, dict[str, float]]:
        """Per label: median, mean, standard deviation and the equal-tailed credible interval."""
        tail = 0.5 * (1.0 - level)
        low, mid, high = np.quantile(self.draws, [tail, 0.5, 1.0 - tail], axis=0)
        return {
            label: {
                "median": float(mid[k]), "mean": float(self.draws[:, k].mean()),
                "sd": float(self.draws[:, k].std(ddof=1)), "lower": float(low[k]), "upper": float(high[k]),
                "level": level,
            }
            for k, label in enumerate(self.labels)
        }  # fmt: skip

    def models(self, count: int = PREDICTIVE_DRAWS) -> list[models.ReflectanceModel]:
        """``count`` models, evenly spaced through the draws."""
        return [with_values(self.template, self.labels, row) for row in self._pick(count)]

    def predict(self, wi: ArrayLike, wo: ArrayLike, level: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """(lower, upper), each (M, C): where a new *measurement* falls with probability ``level``.

        Parameter uncertainty and measurement noise together; the model's own misfit is not in it.
        """
        rng = np.random.default_rng(self.spec.seed)
        rows = self._pick(PREDICTIVE_DRAWS)
        stacked = with_values(self.template, self.labels, rows)
        values = np.asarray(jax.vmap(lambda m: m.evaluate(wi, wo))(stacked))
        sigma = self._noise(rows, values)
        freedom = self.noise.get("degrees_of_freedom")
        z = rng.standard_normal(values.shape) if freedom is None else rng.standard_t(freedom, values.shape)
        drawn = values + sigma * z
        tail = 0.5 * (1.0 - level)
        lower, upper = np.quantile(drawn, [tail, 1.0 - tail], axis=0)
        return lower, upper

    def _pick(self, count: int) -> FloatArray:
        keep = np.linspace(0, len(self.draws) - 1, min(count, len(self.draws))).astype(int)
        return self.draws[keep]

    def _noise(self, rows: FloatArray, values: FloatArray) -> FloatArray:
        """Standard uncertainty of a new measurement per draw, (S, M, C)."""
        channels = self.template.channels
        relative, floor = (
            np.stack(
                [
                    rows[:, self.labels.index(f"{kind}[{c}]")]
                    if f"{kind}[{c}]" in self.labels
                    else np.full(len(rows), self.noise[kind])
                    for c in channels
                ],
                axis=1,
            )[:, None, :]
            for kind in ("relative_noise", "noise_floor")
        )
        return np.hypot(relative * values, floor)

    def to_dict(self) -> dict[str, Any]:
        return {
            "kind": KIND,
            "version": 1,
            "spec": self.spec.model_dump(mode="json"),
            "fit_spec": self.fit_spec.model_dump(mode="json"),
            "model": self.template.to_dict(),
            "labels": list(self.labels),
            "draws": self.draws.tolist(),
            "intervals": self.intervals(),
            "noise": dict(self.noise),
            "diagnostics": {label: d.to_dict() for label, d in self.diagnostics.items()},
            "acceptance": self.acceptance,
            "status": self.status,
            "message": self.message,
            "history": [dict(h) for h in self.history],
            "cost": dict(self.cost),
            "table": dict(self.table),
            "uncertainties": dict(self.uncertainties),
            "warnings": list(self.warnings),
        }

    @staticmethod
    def from_dict(document: Mapping[str, Any]) -> Posterior:
        """The posterior that :meth:`to_dict` wrote. Raises SpecError on anything else."""
        try:
            if document["kind"] != KIND:
                raise KeyError(f"kind is {document['kind']!r}, not {KIND!r}")
            return Posterior(
                spec=spec.posterior_spec(document["spec"]),
                fit_spec=spec.fit_spec(document["fit_spec"]),
                template=models.from_dict(document["model"]),
                labels=tuple(document["labels"]),
                draws=floats(document["draws"]),
                noise=document["noise"],
                diagnostics={
                    label: Diagnostic(**{k: float(floats(v)) for k, v in d.items()})
                    for label, d in document["diagnostics"].items()
                },
                acceptance=document["acceptance"],
                status=document["status"],
                message=document["message"],
                history=tuple(document["history"]),
                cost=document["cost"],
                table=document["table"],
                uncertainties=document["uncertainties"],
                warnings=tuple(document["warnings"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise SpecError(
                f"this is not a posterior ({error})", code="not-a-posterior",
                remedy="give the file that `brdf-fitter posterior --out` wrote",
            ) from error  # fmt: skip

    def save(self, path: Path | str) -> None:
        """Write the posterior as JSON, aside and renamed."""
        write_document(self.to_dict(), Path(path))


def load_posterior(path: Path | str) -> Posterior:
    """Read a posterior that :meth:`Posterior.save` wrote."""
    return Posterior.from_dict(read_document(Path(path), "not-a-posterior"))
