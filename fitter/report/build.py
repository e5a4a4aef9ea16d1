"""build: a table, its fit and its posterior become one report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.formats import describe
from fitter.quality import check
from fitter.report import (
    convergence,
    parameters,
    propagation,
    provenance,
    reflectance,
    residuals,
    robust,
    selection,
    slices,
    verdict,
)
from fitter.report.budget import budget
from fitter.report.clean import clean
from fitter.report.fitted import Fitted
from fitter.report.report import KIND, VERSION, Report

if TYPE_CHECKING:
    from fitter.compression import CompressedTable
    from fitter.fitting.result import FitResult
    from fitter.posterior.jackknife import Robust
    from fitter.posterior.predictive import Predictive
    from fitter.posterior.result import Posterior
    from fitter.table import Table

FloatArray = NDArray[np.float64]


def build(
    table: Table | CompressedTable,
    fit: FitResult,
    posterior: Posterior | None = None,
    *,
    others: Sequence[FitResult] = (),
    without_scans: Robust | None = None,
    bands: Predictive | None = None,
    offsets: Mapping[str, FloatArray] | None = None,
) -> Report:
    """The report of a fit.

    Parameters
    ----------
    table : the table that was fitted; another one is reported on, but the verdict says so first.
    posterior : of the same fit, or None.
    others : further fits of the same table, for the comparison.
    without_scans, bands : :func:`fitter.posterior.robust` and :func:`fitter.posterior.predictive` of the fit,
        or None.
    offsets : :func:`fitter.posterior.offset_sensitivities` of the fit, or None; with them uncertainties are
        propagated to the BRDF and the reflectance.

    Raises
    ------
    SpecError : the table lacks a channel of the fit, or the posterior belongs to another model.
    """
    fitted = Fitted.of(table, fit)
    if posterior is not None and (
        posterior.template.channels != fit.model.channels or posterior.fit_spec.model != fit.spec.model
    ):
        raise SpecError(
            f"the posterior is of {posterior.fit_spec.model.name}, channels "
            f"{', '.join(posterior.template.channels)}, and the fit is of {fit.spec.model.name}, channels "
            f"{', '.join(fit.model.channels)}",
            code="posterior-mismatch", parameter="posterior", remedy="give the posterior of this fit",
        )  # fmt: skip
    seed = fit.spec.seed
    sources = budget(fitted, without_scans, offsets)
    record: dict[str, Any] = {
        "kind": KIND,
        "version": VERSION,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "title": f"{fitted.table.metadata.name or 'table'}: {fit.spec.model.name}",
        "fit": _fit(fitted),
        "parameters": parameters.section(fitted, posterior),
        "robust": robust.section(fitted, without_scans),
        "budget": sources.section,
        "propagation": None if offsets is None else propagation.section(fitted, sources, posterior, seed),
        "correlation": parameters.correlation(fitted),
        "residuals": residuals.section(fitted, seed),
        "slices": slices.section(fitted, posterior, bands, seed),
        "reflectance": reflectance.section(fitted),
        "posterior": convergence.section(fitted, posterior),
        "selection": selection.section(fit),
        "cost": {"cost": fit.cost, "evidence": _search(fit.evidence), "table": _reduced(fit.table)},
        "table": _table(fitted),
        "quality": check(fitted.table).to_dict(),
        "comparison": [_compared(one) for one in (fit, *others)],
        "provenance": provenance.section(fitted, posterior, seed),
        "warnings": list(fit.warnings),
    }
    record = clean(record)
    record["verdict"] = clean(verdict.section(record))
    return Report(record)


def complete(
    table: Table | CompressedTable,
    fit: FitResult,
    posterior: Posterior | None = None,
    *,
    others: Sequence[FitResult] = (),
) -> Report:
    """:func:`build` with robust uncertainties, bands of new measurements and the whole budget, found here: a
    second or two."""
    from fitter import posterior as uncertainty

    without = uncertainty.robust(table, fit)
    bands = uncertainty.predictive(table, fit, without, fit.spec.seed, ["directions"])
    offsets = uncertainty.offset_sensitivities(table, fit)
    return build(
        table, fit, posterior, others=others, without_scans=without, bands=bands, offsets=offsets
    )  # fmt: skip


def _fit(fitted: Fitted) -> dict[str, Any]:
    fit = fitted.fit
    return {
        "model": fit.spec.model.name,
        "spec": fit.spec.model.model_dump(mode="json"),
        "metric": fit.spec.metric or fit.table.get("metric") or "not stated",
        "solver": fit.spec.solver,
        "channels": list(fit.model.channels),
        "samples": int(fit.cost.get("samples", len(fitted.index))),
        "status": fit.status,
        "message": fit.message,
        "metrics": {name: np.asarray(v) for name, v in fit.metrics.items()},
        "uncertainty": fit.uncertainty,
        "seconds": fit.seconds,
    }


def _compared(fit: FitResult) -> dict[str, Any]:
    return {
        "model": fit.spec.model.name,
        "metric": fit.spec.metric or fit.table.get("metric") or "not stated",
        "solver": fit.spec.solver,
        "parameters": len(fit.labels),
        "metrics": {name: np.asarray(v) for name, v in fit.metrics.items()},
        "seconds": fit.seconds,
        "status": fit.status,
        "table_hash": fit.table.get("hash"),
    }


def _search(evidence: Mapping[str, Any]) -> dict[str, Any]:
    """How the optimum was looked for, without how the model was chosen, which has its own section."""
    return {name: value for name, value in evidence.items() if name != "selection"}


def _reduced(table: Mapping[str, Any]) -> dict[str, Any]:
    """What the fit used of the table, without what the table's own section shows."""
    return {name: value for name, value in table.items() if name not in ("domain", "source", "hash", "name")}


def _table(fitted: Fitted) -> dict[str, Any]:
    table, meta = fitted.table, fitted.table.metadata
    fitted_hash = fitted.fit.table.get("hash")
    mismatch = None
    if fitted_hash and fitted_hash != table.hash:
        mismatch = (
            "The table given to this report is not the one that was fitted (their hashes differ): residuals "
            "and slices compare the fit with other data."
        )
    return {
        "description": describe(table),
        "name": meta.name,
        "samples": len(table),
        "usable": int(table.mask.sum()),
        "selected": len(fitted.index),
        "masked": dict(meta.masked),
        "notes": list(meta.notes),
        "domain": table.domain.to_dict(),
        "mismatch": mismatch,
    }
