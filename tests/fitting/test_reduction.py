"""Pseudo-samples: the same sums as the table's, for every family that has them and all parameters."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import fitter
from fitter import models
from fitter.fitting import reduction
from fitter.fitting.layout import layout
from fitter.fitting.polish import normal_equations
from fitter.fitting.usable import usable
from fitter.formats.merl import merl_grid
from fitter.models.pair import Pair
from fitter.spec import FitSpec, ModelSpec, Select
from fitter.table import Table
from tests.fitting.conftest import scattered

#: Every family that states a span.
SPANNED = [
    "ward", "ward:bounded", "ward:duer:no_diffuse", "torrance_sparrow", "torrance_sparrow:ggx:none",
    "torrance_sparrow:blinn", "torrance_sparrow:gaussian:coupled", "oren_nayar", "oren_nayar:full",
    "oren_nayar:fujii", "oren_nayar:eon",
]  # fmt: skip


def grid_table(name: str, seed: int = 0, sigma: bool = False) -> Table:
    """A small half/difference grid with noise, a hole in it, and values that no model explains."""
    grid = merl_grid((12, 10, 14))
    wi, wo = grid.directions()
    rng = np.random.default_rng(seed)
    model = models.create(name, channels=["a", "b"])
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    value = np.where(above[:, None], np.asarray(model.evaluate(wi, wo)), 0.1)
    value = value * rng.uniform(0.8, 1.25, value.shape) + 0.01
    value[100:130] = np.nan
    u = 0.05 * value * rng.uniform(0.5, 2.0, value.shape) if sigma else None
    return Table(value=value, sigma=u, grid=grid)


# What a metric changes, one weight for all channels or one for each, is the same for every family.
@pytest.mark.parametrize(
    ("name", "metric"),
    [
        *((name, "cosine") for name in SPANNED),
        *((name, "measurement") for name in ("ward", "torrance_sparrow:gaussian:coupled", "oren_nayar:full")),
    ],
)
def test_sums_of_pseudo_samples_are_those_of_the_table(name, metric):
    spec = ModelSpec.parse(name)
    table = grid_table(name, sigma=metric == "measurement")
    places = layout(FitSpec(model=spec), 2)
    data = usable(table, metric, Select())
    block = reduction.reduce(places, data, [0, 1])
    assert block is not None
    low, high = places.box
    rng = np.random.default_rng(1)
    for share in (0.02, 0.3, 0.6, 0.98):
        u = low + (high - low) * share
        linear = np.stack([rng.uniform(0.05, 0.6, 2) for _ in range(_size(places))])
        p = np.concatenate([u, linear.reshape(-1)])
        whole = normal_equations(places, metric, data.floor, p, data.blocks([0, 1]))
        few = normal_equations(places, metric, data.floor, p, [block])
        assert few.objective == pytest.approx(whole.objective, rel=1e-10)
        for ours, theirs in ((few.rhs, whole.rhs), (few.matrix, whole.matrix)):
            np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-10 * np.abs(theirs).max())


def _size(places) -> int:
    terms = places.terms(jnp.asarray(places.box[0]), jnp.asarray(np.tile([0, 0, 1.0], 2)[:, None]))
    return len(terms) if places.coefficients_are_free else len(places.linear)


@pytest.mark.parametrize("name", SPANNED)
def test_a_span_holds_between_any_pairs(name):
    """term(q; pair) = sum_j a_j term(q; reference_j), with a from the span's own parameters, for others."""
    spec = ModelSpec.parse(name)
    family = models.family_of(spec)
    span = family.span(spec)
    assert span is not None
    rng = np.random.default_rng(2)
    table = {p.name: p for p in family.parameter_table(spec) if not p.linear}
    for _ in range(50):
        h, d, phi = rng.uniform(0.02, 0.7), rng.uniform(0.02, 0.7), rng.uniform(0, np.pi)
        own = span.within == "theta_h"
        pairs = [(h, d, phi), *((h if own else r[0], *r[1:]) for r in span.references)]
        components = np.stack([
            np.concatenate([w.reshape(3) for w in fitter.directions.vectors_from_half_difference(*p)])
            for p in pairs
        ])  # fmt: skip
        pair = Pair(*jnp.asarray(components.T))

        def terms(values, pair=pair):
            return np.array(family.terms(spec, {k: jnp.asarray(v) for k, v in values.items()}, pair))

        known = np.array([terms(dict(given)) for given in span.parameters])  # (J, K, 1 + J)
        ranges = {n: (0.1, 1.0) if p.search == "log" else p.searched for n, p in table.items()}
        values = {n: rng.uniform(*ends) for n, ends in ranges.items()}
        new = terms(values)
        for k in range(new.shape[0]):
            a = np.linalg.lstsq(known[:, k, 1:], known[:, k, 0], rcond=1e-12)[0]
            assert new[k, 1:] @ a == pytest.approx(new[k, 0], rel=1e-9, abs=1e-12 * np.abs(new).max())


def test_what_has_no_reduction_has_none():
    data = usable(grid_table("ward"), "cosine", Select())
    for name in ("ward:anisotropic", "torrance_sparrow:smith", "lafortune"):
        assert reduction.reduce(layout(FitSpec(model=ModelSpec.parse(name))), data, [0, 1]) is None
    places = layout(FitSpec(model=ModelSpec.parse("ward")))
    assert reduction.reduce(places, usable(grid_table("ward"), "cbrt", Select()), [0, 1]) is None
    loose = scattered(models.create("ward"), seed=1, n=300)
    assert reduction.reduce(places, usable(loose, "cosine", Select()), [0]) is None
    # Oren and Nayar's needs no grid.
    rough = layout(FitSpec(model=ModelSpec.parse("oren_nayar")))
    assert reduction.reduce(rough, usable(loose, "cosine", Select()), [0]) is not None


@pytest.mark.long
@pytest.mark.parametrize("name", ["ward", "oren_nayar:full"])
def test_a_fit_by_pseudo_samples_is_the_fit(name, monkeypatch):
    table = grid_table(name)
    by_few = fitter.fit(table, name, metric="cosine", subset=256)
    assert by_few.evidence["groups"][0]["reduced"]
    monkeypatch.setattr(reduction, "reduce", lambda *_: None)
    by_all = fitter.fit(table, name, metric="cosine", subset=256)
    assert not by_all.evidence["groups"][0]["reduced"]
    for parameter, estimate in by_all.parameters.items():
        ours = by_few.parameters[parameter]
        u = estimate.standard_uncertainty
        np.testing.assert_allclose(ours.value, estimate.value, atol=2e-3 * u.max())
        np.testing.assert_allclose(ours.standard_uncertainty, estimate.standard_uncertainty, rtol=1e-2)
    assert by_few.metrics["objective"] == pytest.approx(by_all.metrics["objective"], rel=1e-8)
    assert by_few.metrics["rmse"] == pytest.approx(by_all.metrics["rmse"], rel=1e-4)
