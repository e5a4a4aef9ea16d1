"""Hand-made fits and posteriors: reports must not depend on what an engine happens to return."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fitter import directions, models
from fitter.fitting.result import Estimate, FitResult
from fitter.metadata import Metadata
from fitter.posterior.result import Diagnostic, Posterior
from fitter.report import Report
from fitter.spec import FitSpec, ModelSpec, PosteriorSpec
from fitter.table import Table

MakeTable = Callable[..., Table]
MakeFit = Callable[..., FitResult]
MakePosterior = Callable[..., Posterior]


def _directions(in_plane: bool, incidences: tuple[float, ...]) -> tuple[Any, Any]:
    theta_o = np.arange(-75.0, 76.0, 7.5)
    azimuths = (180.0,) if in_plane else (100.0, 140.0, 180.0)
    rows = [(i, o, p) for i in incidences for o in theta_o for p in azimuths]
    theta_i, o, phi = np.deg2rad(np.array(rows)).T
    return directions.vector_from_spherical(theta_i, 0.0), directions.vector_from_spherical(o, phi)


def strict(report: Report, *, drawn: bool = False) -> dict[str, Any]:
    """The record after a trip through strict JSON; ``drawn``: its page can be drawn as well."""
    record = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    if drawn:
        assert Report.from_dict(record).html().startswith("<!doctype html>")
    return record


@pytest.fixture(scope="session")
def make_table() -> MakeTable:
    """A table of a Ward surface with 3 % noise; ``channels`` names, ``metadata`` fields by keyword."""

    def make(
        channels: tuple[str, ...] = ("R", "G", "B"), *, in_plane: bool = False,
        incidences: tuple[float, ...] = (0.0, 15.0, 30.0, 45.0, 60.0), rows: int | None = None,
        sigma: bool = False, zero: str | None = None, **metadata: Any,
    ) -> Table:  # fmt: skip
        wi, wo = _directions(in_plane, incidences)
        kd = np.linspace(0.1, 0.3, len(channels))
        model = models.create("ward", channels=channels, kd=kd, ks=0.05, alpha=0.15)
        value = np.asarray(model.evaluate(wi, wo))
        noisy = value * (1 + 0.03 * np.random.default_rng(1).standard_normal(value.shape))
        if zero is not None:
            noisy[:, channels.index(zero)] = 0.0
        some = slice(None) if rows is None else slice(rows)
        return Table(
            wi=wi[some], wo=wo[some], value=noisy[some], sigma=0.03 * value[some] if sigma else None,
            channels=channels, metadata=Metadata(**{"name": "plaster", **metadata}),
        )  # fmt: skip

    return make


@pytest.fixture(scope="session")
def make_fit() -> MakeFit:
    """A FitResult of a table, made without fitting; keywords replace its fields."""

    def make(table: Table, model: str = "ward", *, u: float = 0.02, **changes: Any) -> FitResult:
        spec = ModelSpec.parse(model)
        names = tuple(c.name for c in table.channels)
        given = {"kd": 0.2, "ks": 0.05, "alpha": 0.15}
        declared = models.parameter_table(spec)
        chosen = {p.name: given.get(p.name, p.default) for p in declared}
        found = models.create(spec, channels=names, **chosen)
        parameters: dict[str, Estimate] = {}
        labels: list[str] = []
        for p in declared:
            value = np.asarray(found.values[p.name])
            parameters[p.name] = Estimate(
                value, u * np.abs(value), np.full(value.shape, np.inf), p.unit, p.description,
                (None,) * max(value.size, 1),
            )  # fmt: skip
            labels += [f"{p.name}[{n}]" for n in names] if value.ndim else [p.name]
        deviation = np.concatenate([np.atleast_1d(e.standard_uncertainty) for e in parameters.values()])
        correlation = 0.3 + 0.7 * np.eye(len(deviation))
        result = FitResult(
            spec=FitSpec(model=spec, metric="cosine", seed=7), model=found, parameters=parameters,
            labels=tuple(labels), covariance=correlation * np.outer(deviation, deviation),
            uncertainty="sandwich",
            metrics={"objective": 1e-4, "rmse": 0.01, "relative_rmse": 0.05, "r2": 0.99}, status="converged",
            message="converged in 3 passes", evidence={"groups": [{"starts": 8, "agree": 8}]},
            cost={"seconds": 0.5, "phases": {"search": 0.4}, "passes": 3, "samples": len(table)},
            table={"name": table.metadata.name, "hash": table.hash, "metric": "cosine"},
            versions={"numpy": np.__version__},
        )  # fmt: skip
        return replace(result, **changes)

    return make


@pytest.fixture(scope="session")
def make_posterior() -> MakePosterior:
    """Gaussian draws around a fit, with an inferred relative noise; keywords replace its fields."""

    def make(fit: FitResult, *, draws: int = 400, **changes: Any) -> Posterior:
        rng = np.random.default_rng(3)
        centre = np.concatenate([np.atleast_1d(e.value) for e in fit.parameters.values()])
        names = fit.model.channels
        labels = (*fit.labels, *(f"relative_noise[{n}]" for n in names))
        centre = np.concatenate([centre, np.full(len(names), 0.03)])
        found = centre * (1 + 0.02 * rng.standard_normal((draws, len(centre))))
        posterior = Posterior(
            spec=PosteriorSpec(seed=11), fit_spec=fit.spec, template=fit.model, labels=labels, draws=found,
            noise={"relative_noise": 0.0, "noise_floor": 0.0},
            diagnostics={label: Diagnostic(1.003, 1500.0, 1400.0, 12.0) for label in labels},
            acceptance=0.4, status="converged", message="all targets met",
            history=(
                {"steps": 100, "rhat": 1.2, "ess": 90.0, "seconds": 0.2},
                {"steps": 800, "rhat": 1.003, "ess": 1400.0, "seconds": 1.4},
            ),
            cost={"seconds": 1.5}, table=dict(fit.table),
        )  # fmt: skip
        return replace(posterior, **changes)

    return make
