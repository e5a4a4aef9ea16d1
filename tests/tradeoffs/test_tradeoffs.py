"""Tradeoffs: the front, the held-out blocks, the errors, and a whole measuring read back and drawn."""

from __future__ import annotations

import dataclasses
import json
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fitter
from fitter import SpecError, Table, directions, models
from fitter.progress import Cancelled
from fitter.spec import tradeoff_spec
from fitter.tradeoffs import errors, exhaustive
from fitter.tradeoffs.design import design
from fitter.tradeoffs.front import front
from fitter.tradeoffs.split import split

#: No axis but those that a test names: each further one is a program to compile.
BARE = {
    "metrics": (), "solvers": (), "subsets": (), "starts": (), "tolerances": (), "posterior": False,
    "repeats": 2, "time_limit_seconds": 600.0,
}  # fmt: skip


def goniometer(incidences: list[float], seed: int = 0) -> Table:
    """Rings of viewing directions for each incidence (deg), a rough diffuse surface, 2 % noise."""
    rng = np.random.default_rng(seed)
    theta_i, theta_o, phi = np.meshgrid(
        *(np.deg2rad(angles) for angles in (incidences, np.arange(2, 80, 6), np.arange(0, 180, 15))),
        indexing="ij",
    )
    wi = directions.vector_from_spherical(theta_i.reshape(-1), np.zeros(theta_i.size))
    wo = directions.vector_from_spherical(theta_o.reshape(-1), phi.reshape(-1))
    model = models.create("oren_nayar", rho=[0.3, 0.5, 0.7], sigma=0.4)
    value = np.asarray(model.evaluate(wi, wo)) * (1 + 0.02 * rng.standard_normal((len(wi), 3)))
    return Table(wi=wi, wo=wo, value=value, duplicates="keep")


@pytest.fixture(scope="module")
def table() -> Table:
    return goniometer([5, 15, 25, 35, 45, 55, 65])


@pytest.fixture(scope="module")
def measured(table: Table) -> fitter.Tradeoff:
    asked = {**BARE, "subsets": (256,), "tolerances": (0.001, 0.1)}
    return fitter.tradeoff(table, "oren_nayar", **asked)


NUMBERS = st.one_of(st.none(), st.floats(0, 10).map(lambda x: round(x, 1)))


@given(st.lists(st.tuples(NUMBERS, NUMBERS), max_size=30))
def test_nothing_beats_the_front_and_the_front_beats_the_rest(pairs):
    costs, wrong = [cost for cost, _ in pairs], [error for _, error in pairs]
    on = front(costs, wrong)
    known = [k for k in range(len(pairs)) if None not in pairs[k]]
    assert bool(on) == bool(known)
    for k in known:
        beaten = any(
            costs[j] <= costs[k] and wrong[j] <= wrong[k] and (costs[j], wrong[j]) != (costs[k], wrong[k])
            for j in known
        )
        if k in on:
            assert not beaten
        else:
            assert beaten or any((costs[j], wrong[j]) == (costs[k], wrong[k]) for j in on)


@given(st.lists(st.integers(0, 85), min_size=1, max_size=40, unique=True), st.integers(0, 9))
def test_whole_incidences_are_held_out_and_never_the_outermost(incidences, seed):
    table = goniometer([float(angle) for angle in sorted(incidences)])
    found = split(table, seed)
    if len(incidences) < 3:
        assert found is None
        return
    assert found is not None
    fitted = np.rint(np.rad2deg(np.arccos(table.wi[found.fitted.mask][:, 2].clip(-1, 1))))
    held = np.rint(np.rad2deg(np.arccos(table.wi[~found.fitted.mask][:, 2].clip(-1, 1))))
    assert not set(fitted) & set(held)
    assert min(fitted) < min(held)
    assert max(held) < max(fitted)
    assert len(held) == found.held_out <= 0.5 * len(table)
    assert len(found.value) == min(found.held_out, 20_000)


def test_errors_are_what_they_say(table):
    fit = fitter.fit(table, "oren_nayar")
    assert errors.parameters(fit, fit) == 0.0
    rho = fit.parameters["rho"]
    shifted = dataclasses.replace(rho, value=rho.value + 3.0 * rho.standard_uncertainty)
    other = dataclasses.replace(fit, parameters={**fit.parameters, "rho": shifted})
    assert errors.parameters(other, fit) == pytest.approx(3.0)
    there = errors.reflectances(fit.model, (0.1, 1.0))
    exact = np.stack(
        [fit.model.albedo([np.sin(t), 0.0, np.cos(t)]) for t in np.linspace(0.1, 1.0, len(there))]
    )
    np.testing.assert_allclose(there, exact, rtol=2e-3)
    assert errors.reflectance(1.02 * there, there) == pytest.approx(0.02)


def test_the_design_is_told_before_anything_is_measured(table):
    spec = tradeoff_spec({"models": ["ward", "lafortune"]})
    labels = [one.label for one in design(spec, table)]
    assert labels[:2] == ["ward", "lafortune"]
    assert len(labels) == len(set(labels))
    assert {one.axis for one in design(spec, table)} >= {
        "default", "subset", "starts", "solver", "metric", "compression"
    }  # fmt: skip
    with pytest.raises(SpecError):
        design(tradeoff_spec({"models": ["he_torrance"]}), table)


@pytest.mark.parametrize(
    "asked", [{}, {"models": []}, {"models": ["ward"], "repeats": 0}, {"models": ["ward"], "subsets": [1]}]
)
def test_nonsense_is_refused(asked):
    with pytest.raises(SpecError):
        tradeoff_spec(asked)


def test_a_measuring_holds_every_kind_of_point(measured, table):
    by_axis = {axis: [p for p in measured.points if p.axis == axis] for axis in ("default", "reference")}
    assert len(by_axis["default"]) == len(by_axis["reference"]) == 1
    default, reference = by_axis["default"][0], by_axis["reference"][0]
    assert default.errors["parameters"] < 0.05
    assert reference.errors["parameters"] == 0.0
    assert default.errors["held_out"] == pytest.approx(0.02, rel=0.3)  # the noise is all there is
    subset = next(p for p in measured.points if p.axis == "subset")
    assert subset.errors["parameters"] > default.errors["parameters"]
    for point in measured.points:
        assert 0 < point.seconds["min"] <= point.seconds["median"]
        assert point.seconds["compile"] <= point.seconds["first"]
    assert {p.settings["dtype"] for p in measured.points if p.axis == "precision"} == {"float32", "float64"}
    assert any("held_out/seconds" in p.front for p in measured.points)
    assert not any("parameters/seconds" in p.front for p in by_axis["reference"])
    assert measured.table["fitted"] + measured.table["held_out"] == len(table)
    assert measured.skipped == ()


def test_a_looser_tolerance_is_smaller_and_worse(measured):
    tight, loose = measured.compression
    assert (tight["tolerance"], loose["tolerance"]) == (0.001, 0.1)
    assert loose["bytes"] < tight["bytes"]
    assert loose["worst_error"] <= 0.1
    assert tight["worst_error"] <= 0.001
    assert tight["parameters"] < loose["parameters"]


def test_the_reference_is_the_lowest_of_an_exhaustive_scan(measured):
    (reference,) = measured.references
    assert reference["scan"]["nodes"] >= 500
    assert reference["scan"]["minima"] >= 1
    assert reference["scan"]["best_node"] > -1e-3
    assert reference["starts"] > 3


def test_a_scan_sees_a_fit_that_is_no_optimum(table):
    fit = fitter.fit(table, "oren_nayar", metric="cosine")
    assert exhaustive.scan(table, fit)["best_node"] > -1e-9
    sigma = fit.parameters["sigma"]
    wrong = dataclasses.replace(sigma, value=sigma.value * 1.5)
    worse = dataclasses.replace(fit, parameters={**fit.parameters, "sigma": wrong})
    assert exhaustive.scan(table, worse)["best_node"] < -1e-2


@pytest.mark.long
def test_what_was_measured_is_read_back_and_drawn(measured, tmp_path):
    measured.save(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "tradeoff.html", "tradeoff.json", "tradeoff.png"
    ]  # fmt: skip
    read = fitter.load_tradeoff(tmp_path / "tradeoff.json")
    assert json.dumps(read.to_dict()) == json.dumps(measured.to_dict())
    png = (tmp_path / "tradeoff.png").read_bytes()
    assert png.startswith(b"\x89PNG")
    assert struct.unpack(">2I", png[16:24])[0] > 1200
    page = (tmp_path / "tradeoff.html").read_text()
    assert "oren_nayar: 256 samples" in page
    assert "http://" not in page
    assert "https://" not in page
    assert measured.picture("svg").startswith(b"<?xml")
    with pytest.raises(SpecError, match="not a tradeoff"):
        fitter.Tradeoff.from_dict({"kind": "brdf-fitter/fit"})


def test_the_time_limit_leaves_out_and_says_so(table):
    found = fitter.tradeoff(table, "oren_nayar", **{**BARE, "subsets": (256,), "time_limit_seconds": 1e-3})
    assert "oren_nayar: 256 samples" in found.skipped
    assert [p.axis for p in found.points if p.axis not in ("reference", "precision")] == ["default"]


def test_it_stops_when_it_is_told_to(table):
    def stop(share: float, what: str) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        fitter.tradeoff(table, "oren_nayar", progress=stop, **BARE)


def test_a_table_of_one_incidence_holds_nothing_out():
    found = fitter.tradeoff(goniometer([30.0]), "oren_nayar", **BARE)
    assert found.table["held_out"] == 0
    assert all(p.errors["held_out"] is None for p in found.points)
    assert "held out" in found.notes[0]
    assert found.picture().startswith(b"\x89PNG")
