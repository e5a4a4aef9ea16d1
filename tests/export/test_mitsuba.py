"""Mitsuba 3 itself reads what is exported, and says what the library says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fitter
from fitter import models
from fitter.export import subject, write
from fitter.export.fidelity import compared_pairs
from fitter.models import ReflectanceModel
from tests.export.conftest import FloatArray, held_to_the_contract, make
from tests.models.statistics import chi_square_p
from tests.scene import test_mitsuba as pictures


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


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> tuple[ReflectanceModel, Path]:
    model, path = make("torrance_sparrow"), tmp_path_factory.mktemp("rgl") / "m.bsdf"
    held_to_the_contract(write(model, "rgl", path))
    return model, path


@pytest.fixture(scope="module")
def brushed(tmp_path_factory: pytest.TempPathFactory) -> tuple[ReflectanceModel, Path]:
    """A metal four times as rough across as along, whose file holds a quarter of the incident azimuths."""
    model = models.create(
        "torrance_sparrow:ggx:smith:anisotropic:conductor:no_diffuse", channels=("R", "G", "B"), ks=1.0,
        eta=[0.2, 0.4, 1.5], kappa=[3.0, 2.0, 2.0], alpha_x=0.05, alpha_y=0.2,
    )  # fmt: skip
    path = tmp_path_factory.mktemp("rgl") / "m.bsdf"
    told = write(model, "rgl", path)
    held_to_the_contract(told)
    (said,) = [note.message for note in told.notes if note.code == "resolution"]
    assert f"{path.stat().st_size / 1e6:.1f} MB" in said
    return model, path


# The study tests/evidence/exports.py has all families, more anisotropic ones and tables.
@pytest.mark.long
@pytest.mark.parametrize("name", ["painted", "brushed"])
def test_measured_is_ours_times_the_cosine(mi: Any, name: str, request: pytest.FixtureRequest) -> None:
    """At 10^4 directions, half of them from the model's own sampler; and it draws as its density says."""
    model, path = request.getfixturevalue(name)
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    wi, wo = compared_pairs(subject(model), 10_000)
    ours = np.asarray(model.evaluate(wi, wo)) * wo[:, 2:]
    change = np.abs(evaluated(mi, bsdf, wi, wo) - ours) / ours
    assert np.quantile(change, 0.95) < 0.01
    light = np.array([0.36, 0.48, 0.8])
    chance, weight = _chance(mi, bsdf, light, 4_000)
    assert chance > 1e-3
    # Luminance is what it draws by: there the weights hardly differ.
    luminance = np.array([0.212671, 0.715160, 0.072169])
    assert weight @ luminance == pytest.approx(np.asarray(model.albedo(light)) @ luminance, rel=0.01)


def test_measured_of_a_table_is_its_interpolant(mi: Any, tmp_path: Path) -> None:
    table = fitter.load(Path(__file__).resolve().parents[2] / "data" / "tables" / "diffuse_plaster.csv")
    write(table, "rgl", tmp_path / "m.bsdf")
    bsdf = mi.load_dict({"type": "measured", "filename": str(tmp_path / "m.bsdf")})
    wi, wo = compared_pairs(subject(table), 10_000)
    change = np.abs(evaluated(mi, bsdf, wi, wo) / wo[:, 2:] - table.evaluate(wi, wo)[0])
    assert np.quantile(change / table.evaluate(wi, wo)[0], 0.95) < 0.01


def _edges() -> tuple[FloatArray, FloatArray]:
    return np.linspace(0, np.pi / 2, 9), np.linspace(-np.pi, np.pi, 13)


def _chance(mi: Any, bsdf: Any, wi: FloatArray, count: int) -> tuple[float, FloatArray]:
    """p of the chi-square test of ``sample`` against ``pdf``, and the mean weight."""
    context, at = mi.BSDFContext(), mi.SurfaceInteraction3f()
    at.wi = wi.tolist()
    rng = np.random.default_rng(3)
    wo, weight = np.zeros((count, 3)), np.zeros((count, 3))
    for k, u in enumerate(rng.random((count, 3)).tolist()):
        drawn, value = bsdf.sample(context, at, u[0], u[1:])
        wo[k], weight[k] = drawn.wo, value
        if k % 100 == 0 and drawn.pdf > 0:
            assert bsdf.pdf(context, at, drawn.wo) == pytest.approx(drawn.pdf, rel=1e-4)
            value_there = np.array(bsdf.eval(context, at, drawn.wo)) / drawn.pdf
            np.testing.assert_allclose(value, value_there, rtol=1e-4)
    kept = wo[:, 2] > 0
    theta, phi = np.arccos(wo[kept, 2]), np.arctan2(wo[kept, 1], wo[kept, 0])
    found = np.histogram2d(theta, phi, _edges())[0]
    x, w = np.polynomial.legendre.leggauss(4)
    nodes = [
        (a[:-1, None] + 0.5 * np.diff(a)[:, None] * (1 + x), 0.5 * np.diff(a)[:, None] * w) for a in _edges()
    ]
    expected = np.zeros_like(found)
    for i, (thetas, w_theta) in enumerate(zip(*nodes[0], strict=True)):
        for j, (phis, w_phi) in enumerate(zip(*nodes[1], strict=True)):
            for theta, a in zip(thetas, w_theta, strict=True):
                for phi, b in zip(phis, w_phi, strict=True):
                    s = np.sin(theta)
                    direction = [s * np.cos(phi), s * np.sin(phi), np.cos(theta)]
                    expected[i, j] += count * a * b * s * bsdf.pdf(context, at, direction)
    return chi_square_p(found.reshape(-1), expected.reshape(-1)), weight.mean(axis=0)


@pytest.mark.parametrize("name", ["torrance_sparrow", "ward:bounded:anisotropic"])
def test_the_plugin_draws_the_model(mi: Any, name: str, tmp_path: Path) -> None:
    import fitter.export.mitsuba as plugin

    model = make(name)
    write(model, "json", tmp_path / "m.json")
    bsdf = mi.load_dict({"type": plugin.MODEL, "filename": str(tmp_path / "m.json")})
    wi, wo = (w[:200] for w in compared_pairs(subject(model), 1000))
    ours = np.asarray(model.evaluate(wi, wo)) * wo[:, 2:]
    np.testing.assert_allclose(evaluated(mi, bsdf, wi, wo), ours, rtol=2e-5)
    light = np.array([0.6, 0.0, 0.8])
    chance, weight = _chance(mi, bsdf, light, 10_000)
    assert chance > 1e-3
    np.testing.assert_allclose(weight, model.albedo(light), rtol=0.05)


def test_the_plugin_draws_the_table(mi: Any) -> None:
    import fitter.export.mitsuba as plugin

    path = Path(__file__).resolve().parents[2] / "data" / "tables" / "diffuse_plaster.csv"
    bsdf = mi.load_dict({"type": plugin.TABLE, "filename": str(path)})
    table = fitter.load(path)
    wi, wo = (w[::80] for w in compared_pairs(subject(table), 4000))
    ours = table.evaluate(wi, wo)[0]
    # As Mitsuba asks: the first direction is the viewer's.
    theirs = evaluated(mi, bsdf, wo, wi) / wi[:, 2:]
    np.testing.assert_allclose(theirs[:, : ours.shape[1]], ours, rtol=2e-5)
    chance, _ = _chance(mi, bsdf, np.array([0.5, 0.0, 0.75**0.5]), 600)
    assert chance > 1e-3


@pytest.fixture(scope="module")
def pictured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A model as a document and as a file, and this library's picture of a ball of it under a smooth sky."""
    folder = tmp_path_factory.mktemp("picture")
    values = {"kd": 0.2, "ks": 1.0, "f0": 0.2, "alpha": 0.3}
    model = models.create("torrance_sparrow:ggx:smith", channels=("value",), **values)
    write(model, "json", folder / "m.json")
    write(model, "rgl", folder / "m.bsdf")
    ball = {"model": {"family": "torrance_sparrow", "ndf": "ggx", "masking": "smith"}, "values": values}
    return folder, pictures.ours("environment", pictures.LAMBERT[0], ball, folder)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["plugin", "measured"])
def test_a_picture_is_ours(mi: Any, kind: str, pictured: tuple[Path, Any]) -> None:
    import fitter.export.mitsuba as plugin

    folder, ours = pictured
    of = {
        "plugin": {"type": plugin.MODEL, "filename": str(folder / "m.json")},
        "measured": {"type": "measured", "filename": str(folder / "m.bsdf")},
    }
    theirs = pictures.theirs("environment", pictures.LAMBERT[1], of[kind])
    pictures.assert_same(ours, theirs)
    # It would see 2 %.
    with pytest.raises(AssertionError):
        pictures.assert_same((1.02 * ours[0], ours[1]), theirs)
