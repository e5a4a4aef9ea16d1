"""select: the truth comes back, the simpler of equals is taken, and what can't be told is said."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import fitter
from fitter import FitError, SpecError, models
from fitter.progress import Cancelled
from fitter.selection import Selection, select
from tests.selection.conftest import TRUTHS, geometry, known, measured


def checked(found: Selection) -> Selection:
    """What holds of every comparison."""
    document = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert document["chosen"] == found.chosen.spec.model.name
    assert found.chosen.evidence["selection"]["ranking"] == document["ranking"]
    compared = [one for one in found.ranking if one.held_out]
    best = compared[0] if compared else found.ranking[0]
    for one in compared:
        assert one.error >= best.error
        assert one.against_best is not None
        assert one.error / best.error == pytest.approx(one.against_best.ratio)
        assert len(one.errors_by_fold) == found.folds["folds"]
    for one in found.ranking:
        # Dismissed on its fit alone: then not even the error of the fit is near the best's.
        assert one.held_out or not compared or one.error > 1.1 * best.error
    chosen = next(one for one in found.ranking if one.model == found.chosen.spec.model.name)
    assert chosen.as_good
    assert all(chosen.parameters <= one.parameters for one in found.ranking if one.as_good)
    return found


@pytest.mark.long
@pytest.mark.parametrize("name", TRUTHS)
def test_the_model_that_made_the_table_is_chosen(name, plain):
    truth = known(name)
    found = checked(select(measured(truth), candidates=plain))
    assert found.method == "cross_validation"
    assert found.folds["kind"] == "theta_i"
    assert found.chosen.spec.model.name == name, found.sentences
    assert found.verdict == "model"
    # The chosen fit is the one that asking for it by name gives.
    alone = fitter.fit(measured(truth), name)
    assert alone.spec == found.chosen.spec
    for parameter, estimate in alone.parameters.items():
        np.testing.assert_array_equal(found.chosen.parameters[parameter].value, estimate.value)


@pytest.mark.parametrize("seed", range(6))
def test_a_lambertian_table_needs_no_roughness(seed):
    found = checked(select(measured(known("lambert"), seed), candidates=("lambert", "oren_nayar")))
    assert found.chosen.spec.model.name == "lambert"


def test_a_lambertian_fit_is_the_mean():
    """No nonlinear parameter: what is left is one linear problem."""
    table = measured(known("lambert"))
    fit = fitter.fit(table, "lambert", metric="absolute")
    assert fit.status == "converged"
    assert fit.parameters["kd"].value[0] == pytest.approx(np.pi * table.value.mean(), rel=1e-12)
    other = fitter.fit(table, "lambert", metric="absolute", solver="nlopt")
    assert other.parameters["kd"].value[0] == pytest.approx(np.pi * table.value.mean(), rel=1e-9)


@pytest.mark.long
def test_held_out_errors_are_no_smaller_than_fitted_ones(plain):
    """The inequality that lets a model be dismissed before any scan is held out."""
    from fitter.progress import ignore
    from fitter.selection.data import Data
    from fitter.selection.trial import cross_validated, fitted
    from fitter.spec import ModelSpec, SelectionSpec

    spec = SelectionSpec()
    data = Data.of(measured(known("ward"), noise=0.1), spec)
    for name in plain:
        trial = fitted(data, ModelSpec.parse(name), spec, ignore)
        held = cross_validated(data, trial, None, spec, ignore)
        assert held.held_out is not None
        assert (held.held_out >= trial.fitted * (1 - 1e-6)).all()


@pytest.mark.long
def test_an_isotropic_surface_measured_at_several_azimuths_needs_no_anisotropic_model():
    scans = {"incidences": (0, 20, 40, 60), "azimuths": (0, 60, 120), "step": 20.0}
    both = ("ward", "ward:anisotropic")
    found = checked(select(measured(known("ward"), **scans), candidates=both))
    assert found.chosen.spec.model.name == "ward"
    brushed = models.create(
        "ward:anisotropic", channels=("value",), kd=0.15, ks=0.1, alpha_x=0.1, alpha_y=0.4, psi=0.5
    )
    found = checked(select(measured(brushed, **scans), candidates=both))
    assert found.chosen.spec.model.name == "ward:anisotropic"


def test_one_incidence_leaves_an_information_criterion_only(plain):
    table = measured(known("ward"), incidences=(30,), step=2.5)
    found = checked(select(table, candidates=plain))
    assert found.method == "information_criterion"
    assert found.verdict == "not_judged"
    assert found.chosen.spec.model.name == "ward"
    assert all(not one.held_out and one.against_best is None for one in found.ranking)
    assert any("one incidence only" in sentence for sentence in found.sentences)


def test_a_table_that_no_model_describes_is_better_used_as_it_is():
    wi, wo = geometry(tuple(range(0, 75, 5)), step=5.0)
    # A lobe that no mirror, no light and no normal is near.
    value = 0.05 + np.exp(-30 * np.square(wo - [0.0, 0.7, math.sqrt(0.51)]).sum(axis=1))
    # And the same on the other side: scans of isotropic tables may be mirrored.
    value += np.exp(-30 * np.square(wo - [0.0, -0.7, math.sqrt(0.51)]).sum(axis=1))
    table = fitter.Table(wi=wi, wo=wo, value=value, channels=["value"])
    found = checked(select(table, candidates=("lambert", "ward")))
    assert found.verdict == "raw_table"
    assert found.raw is not None
    assert found.raw.model_over_raw.lower > 1
    assert found.chosen.warnings[-1].startswith("no model is good enough")


def test_stated_noise_is_what_a_model_has_to_reach():
    table = measured(known("ward"), misfit=0.0, sigma=True)
    found = checked(select(table, candidates=("lambert", "ward")))
    assert found.chosen.spec.model.name == "ward"
    assert found.noise_ratio == pytest.approx(1.0, abs=0.1)
    assert "noise alone" in found.sentences[1]


def test_a_model_that_the_table_does_not_determine_is_no_candidate():
    """A Lambertian table has no lobe whose width could be found."""
    found = checked(select(measured(known("lambert"), noise=0.0, misfit=0.0), candidates=("lambert", "ward")))
    assert found.chosen.spec.model.name == "lambert"
    assert {one.model for one in found.not_candidates} | {one.model for one in found.ranking} == {
        "lambert", "ward"
    }  # fmt: skip


def test_all_candidates_may_fail():
    wi, wo = geometry((30,))
    table = fitter.Table(wi=wi[:2], wo=wo[:2], value=[0.1, 0.2], channels=["value"])
    with pytest.raises(FitError, match="supports none") as caught:
        select(table, candidates=("ward", "lafortune"))
    assert caught.value.code == "no-candidate"
    assert "ward: 2 usable values" in str(caught.value)


def test_bad_requests_are_refused_at_once():
    table = measured(known("lambert"))
    with pytest.raises(SpecError, match="a candidate twice"):
        select(table, candidates=("ward", "ward"))
    with pytest.raises(SpecError, match="fitted"):
        select(table, candidates=("smooth_dielectric",))
    with pytest.raises(SpecError, match="one model"):
        fitter.fit(table, "auto", fixed={"alpha": 0.1})
    with pytest.raises(SpecError, match="no channel"):
        select(table, select={"channels": ["X"]})


def test_progress_grows_and_stops_the_work():
    seen: list[float] = []
    two = ("lambert", "oren_nayar")
    select(measured(known("lambert")), candidates=two, progress=lambda share, what: seen.append(share))
    assert seen == sorted(seen)
    assert seen[-1] == 1.0

    def stop(share: float, what: str) -> None:
        if share > 0.1:
            raise Cancelled

    with pytest.raises(Cancelled):
        select(measured(known("lambert")), candidates=two, progress=stop)


def test_a_budget_ends_the_list_and_says_so(plain):
    found = select(measured(known("lambert")), candidates=plain, budget_seconds=1e-9)
    assert {one.model for one in found.not_candidates} == set(plain) - {"lambert"}
    assert all("were spent" in one.reason for one in found.not_candidates)


@pytest.mark.long
def test_retro_reflective_tape_needs_several_lobes(shared: Path):
    table = fitter.load(shared / "measured/retro/retro-3M-jaune.dat", quantity="brdf")
    # A search as large as that of the folds: the last fit then needs no program of its own.
    found = checked(select(table, candidates=("lambert", "lafortune", "lafortune:2"), subset=1024))
    assert found.folds["kind"] == "theta_o"
    assert found.chosen.spec.model.name == "lafortune:2"
    assert "Compared on 6,1" in found.sentences[-1]


@pytest.mark.long
def test_sintered_ptfe_is_diffuse_before_it_is_glossy(shared: Path):
    declared = {
        "lambda": "wavelength_um", "thetai": "theta_i_deg", "phi": "phi_i_deg", "thetar": "theta_o_deg",
        "phir": "phi_o_deg", "f_r11": "brdf",
    }  # fmt: skip
    table = fitter.load(shared / "measured/nist_ptfe/PTFE.data.csv", columns=declared, item="633nm")
    found = checked(select(table, candidates=("lambert", "oren_nayar", "ward"), subset=1024))
    errors = {one.model: one.relative_error for one in found.ranking}
    assert errors["lambert"] < 0.1
    assert found.folds["blocks"] >= 4
