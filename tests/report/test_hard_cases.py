"""Tables and posteriors that could upset a report: it is made, and its page can be drawn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fitter import directions, models
from fitter.report import build
from fitter.table import Table
from tests.report.conftest import MakeFit, MakePosterior, MakeTable, strict

HARD = {
    "one sample": {"rows": 1},
    "two samples": {"rows": 2},
    "one incidence": {"incidences": (30.0,)},
    "normal incidence": {"incidences": (0.0,)},
    "in plane": {"in_plane": True},
    "one channel": {"channels": ("value",)},
    "a channel of zeros": {"zero": "G"},
    "formulas for names": {"channels": (r"$\frac{", "漢字", "a" * 300)},
    "bytes for a name": {"name": "caf\udce9"},
}
WITH_POSTERIOR = ("one sample", "in plane", "formulas for names")


@pytest.mark.long
@pytest.mark.parametrize("case", HARD)
def test_hard_tables(
    case: str, make_table: MakeTable, make_fit: MakeFit, make_posterior: MakePosterior
) -> None:
    keywords: dict[str, Any] = HARD[case]
    table = make_table(**keywords)
    fit = make_fit(table)
    # A posterior costs a compilation: where the geometry or a name can upset its figures.
    posterior = make_posterior(fit, draws=60) if case in WITH_POSTERIOR else None
    record = strict(build(table, fit, posterior), drawn=True)
    assert record["residuals"]["samples"] == int(table.mask.sum())
    if case == "a channel of zeros":
        by_name = {row["channel"]: row["relative_rmse"] for row in record["residuals"]["per_channel"]}
        assert by_name["G"] is None
        assert by_name["R"] is not None


def test_a_scattered_anisotropic_table(make_fit: MakeFit) -> None:
    rng = np.random.default_rng(5)
    theta, phi = np.arccos(1 - 0.9 * rng.random((2, 3000))), 2 * np.pi * rng.random((2, 3000))
    wi, wo = (directions.vector_from_spherical(theta[k], phi[k]) for k in (0, 1))
    value = np.asarray(models.create("ward", kd=0.2, ks=0.05, alpha=0.15).evaluate(wi, wo))
    table = Table(wi=wi, wo=wo, value=value)
    assert table.symmetry == "anisotropic"
    record = strict(build(table, make_fit(table)))
    assert record["slices"]["azimuth_deg"] is not None


def test_draws_that_do_not_vary(
    make_table: MakeTable, make_fit: MakeFit, make_posterior: MakePosterior
) -> None:
    table = make_table(("value",))
    fit = make_fit(table)
    posterior = make_posterior(fit)
    stuck = replace(posterior, draws=np.repeat(posterior.draws[:1], 100, axis=0), history=(), diagnostics={})
    record = strict(build(table, fit, stuck), drawn=True)
    assert record["posterior"]["corner"]["labels"] == []
    assert record["posterior"]["largest_rhat"] is None
