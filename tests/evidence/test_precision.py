"""The study finds what it is there to find: a wrong digit, a NaN, a wrong derivative, a narrowed range."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest
from mpmath import mp

from fitter import models
from fitter.models import Parameter
from fitter.spec import model_spec
from tests.evidence import domain, page, precision
from tests.evidence.differences import gradient
from tests.evidence.reference import DIGITS
from tests.evidence.running import merged
from tests.evidence.study import studies


def test_a_good_model_passes():
    found = precision.judge("ward", 0.01, 3)
    assert not found.violations
    assert 0 < found.figures["float64 worst"] < 1
    assert 0 < found.figures["gradient worst"] < 1


@pytest.mark.parametrize("fault", [1 + 1e-4, np.nan])
def test_a_wrong_value_is_found(monkeypatch: pytest.MonkeyPatch, fault: float):
    right = precision._program("lambert")

    def wrong(*given: Any) -> jax.Array:
        return right(*given) * np.float32(fault)

    monkeypatch.setattr(precision, "_program", lambda name: wrong)
    found = precision.judge("lambert", 0.01, 3)
    told = {one["what"] for one in found.violations}
    assert {"float64 value", "float32 value"} <= told
    # Every point but those where the albedo is 0 (or where 1.0001 x 0 is still right).
    assert found.figures["float64 broken"] >= 3


def test_a_wrong_derivative_is_found_and_a_radial_one_is_not(monkeypatch: pytest.MonkeyPatch):
    points = precision.Points(model_spec("ward"), 12, 3, "float64")
    right = precision._gradient_program("ward")

    def judged(by: str) -> list[str]:
        def wrong(values: Any, wi: Any, wo: Any) -> Any:
            by_value, by_wi, by_wo = right(values, wi, wo)
            if by == "radial":
                return by_value, by_wi + wi * np.linalg.norm(by_wi, axis=1, keepdims=True), by_wo
            return by_value, by_wi, by_wo * (1 + 1e-3)

        monkeypatch.setattr(precision, "_gradient_program", lambda name: wrong)
        with mp.workdps(DIGITS):
            return [one["what"] for one in precision._gradients(points)[1]]

    assert not judged("radial")
    found = judged("scaled")
    assert found
    assert all("gradient by o" in what for what in found)


def test_at_a_tie_either_side_is_right():
    """iz = oz: the qualitative Oren-Nayar model has max(iz, oz) in it."""
    spec, wi, wo = model_spec("oren_nayar"), np.array([0.6, 0.0, 0.8]), np.array([0.36, 0.48, 0.8])
    points = precision.Points(spec, 1, 0, "float64")
    points.wi, points.wo = wi[None], wo[None]
    points.values = {"rho": np.array([0.5]), "sigma": np.array([0.4])}
    with mp.workdps(DIGITS):
        found = gradient(points.function, points.exact(0))
        assert found.low[2] < found.high[2]
        assert found.low[5] < found.high[5]
        assert precision._gradients(points)[0] <= 1


def test_a_narrowed_range_is_told():
    table = (Parameter("a_alpha", "1", 1e-3, 1.0, 0.1, "roughness"),)
    assert domain.narrower(table) == ["a_alpha is bounded to [0.001, 1], promised is [0.0001, 1]"]


def test_every_parameter_of_the_suite_has_a_rule():
    for name in precision.asked():
        drawn = domain.values(np.random.default_rng(0), models.parameter_table(name), 3, inside_too=False)
        assert list(drawn) == [p.name for p in models.parameter_table(name)]


def test_hard_directions_stay_above_the_horizon_and_are_hard():
    wi, wo, stratum = domain.directions(np.random.default_rng(1), np.full(2000, 1e-3))
    assert set(stratum) == set(domain.STRATA)
    for w in (wi, wo):
        np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1.0, atol=1e-15)
        assert w[:, 2].min() >= 0.99 * domain.LOWEST_COSINE
        assert (w[:, 2] < 1e-5).sum() > 50
        assert (w[:, 2] == 1.0).sum() > 20
    apart = np.linalg.norm(wo - wi * [-1, -1, 1], axis=1)
    assert ((apart > 0) & (apart < 1e-7)).sum() > 10


def test_studies_are_found_by_name_and_their_page_has_their_figures():
    assert studies()["precision"] is precision.STUDY
    row = {"model": "ward", "seconds": 1.0, "figures": {"float64 worst": 0.0312, "float64 points": 1500},
           "violations": [{"what": "float64 value", "ratio": 3.0}]}  # fmt: skip
    study = {
        "title": "T", "claim": "c", "columns": ["float64 points", "float64 worst"], "rows": [row],
        "skipped": {"specular": "a delta"},
    }  # fmt: skip
    text = "\n".join([*page.table(study)])
    assert "| ward | 1,500 | 0.0312 | 1 | 1 |" in text


def test_studies_that_are_not_run_again_keep_their_figures():
    def study(name: str, seed: int) -> dict[str, Any]:
        machine = {"cpu": "c", "cores": 2, "memory_gb": 1.0, "system": "s"}
        run = {
            "created": "2026-01-01T00:00:00", "share": 1.0, "seed": seed, "seconds": 2.0, "machine": machine,
            "versions": {"numpy": "2"}, "commit": "abc", "uncommitted_changes": False,
        }  # fmt: skip
        empty = {"columns": [], "skipped": {}, "rows": []}
        return {"name": name, "title": name, "claim": "c", "run": run, **empty}

    before = {"version": 2, "studies": [study("fuzz", 1), study("precision", 2)]}
    found = merged(before, {"version": 2, "studies": [study("chi_square", 3), study("fuzz", 4)]})
    assert [(one["name"], one["run"]["seed"]) for one in found["studies"]] == [
        ("chi_square", 3), ("fuzz", 4), ("precision", 2)
    ]  # fmt: skip
    text = "\n".join(page.lines(found))
    assert [text.index(f"seed {k}") for k in (3, 4, 2)] == sorted(text.index(f"seed {k}") for k in (2, 3, 4))
