"""Mitsuba 3 itself reads what is exported, and says what the library says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fitter
from fitter.export import subject, write
from fitter.export.fidelity import compared_pairs
from tests.export.conftest import FloatArray, make


@pytest.fixture(scope="module")
def mi() -> Any:
    mitsuba = pytest.importorskip("mitsuba", reason="NO MITSUBA: its reading of exports is not checked")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


def evaluated(mi: Any, bsdf: Any, wi: FloatArray, wo: FloatArray) -> FloatArray:
    """f_r cos(theta_o) (M, 3) as Mitsuba has it. Its wi is the viewer, which a reciprocal f_r can't tell."""
    context, at = mi.BSDFContext(), mi.SurfaceInteraction3f()
    found = np.empty((len(wi), 3))
    for k, (i, o) in enumerate(zip(wi.tolist(), wo.tolist(), strict=True)):
        at.wi = i
        found[k] = np.asarray(bsdf.eval(context, at, o))
    return found


# The study tests/evidence/exports.py has all families, anisotropic ones and tables.
@pytest.mark.parametrize(("name", "most"), [("torrance_sparrow", 0.01), ("lafortune:2", 0.03)])
def test_measured_is_ours_times_the_cosine(mi: Any, name: str, most: float, tmp_path: Path) -> None:
    """At 10^4 directions, half of them from the model's own sampler."""
    model = make(name)
    write(model, "rgl", tmp_path / "m.bsdf")
    bsdf = mi.load_dict({"type": "measured", "filename": str(tmp_path / "m.bsdf")})
    wi, wo = compared_pairs(subject(model), 10_000)
    ours = np.asarray(model.evaluate(wi, wo)) * wo[:, 2:]
    change = np.abs(evaluated(mi, bsdf, wi, wo) - ours) / ours
    assert np.quantile(change, 0.95) < most


def test_measured_of_a_table_is_its_interpolant(mi: Any, tmp_path: Path) -> None:
    table = fitter.load(Path(__file__).resolve().parents[2] / "data" / "tables" / "diffuse_plaster.csv")
    write(table, "rgl", tmp_path / "m.bsdf")
    bsdf = mi.load_dict({"type": "measured", "filename": str(tmp_path / "m.bsdf")})
    wi, wo = compared_pairs(subject(table), 10_000)
    change = np.abs(evaluated(mi, bsdf, wi, wo) / wo[:, 2:] - table.evaluate(wi, wo)[0])
    assert np.quantile(change / table.evaluate(wi, wo)[0], 0.95) < 0.02
