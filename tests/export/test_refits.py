"""Refits: the target's own reader takes the file, the formula is the target's, the residual is told."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fitter
from fitter import models
from fitter.errors import SpecError
from fitter.export import subject, target, write
from fitter.export.fidelity import compared_pairs
from fitter.export.principled import principled
from fitter.models import ReflectanceModel
from tests.export.conftest import make
from tests.export.test_mitsuba import evaluated, mi  # noqa: F401 (a fixture)

#: A material's name that would end a comment, a line or a string in one language or another.
NASTY = 'worn --> <brass> */ \\ " & \x01 é\n\\'

REFITS = ("gltf", "materialx", "mitsuba-principled", "mitsuba-conductor", "radiance")


@pytest.fixture(scope="module")
def metal() -> ReflectanceModel:
    return models.create(
        "torrance_sparrow:ggx:smith:no_diffuse",
        channels=("R", "G", "B"),
        ks=1.0,
        f0=[0.9, 0.6, 0.3],
        alpha=0.2,
    )


@pytest.mark.parametrize("name", REFITS)
def test_a_refit_says_its_residual(metal: ReflectanceModel, name: str, tmp_path: Path) -> None:
    told = write(metal, name, tmp_path / "m")
    (note,) = told.notes
    assert note.code == "refit"
    assert f"{told.residuals['refit']:.1%}" in note.message
    # The first three have this metal in them.
    assert 0 < told.residuals["refit"] < (0.02 if name != "radiance" else 1.0)
    assert note.message in (tmp_path / "m").read_text()
    assert told.residuals["ours"] is None
    with pytest.raises(SpecError, match="holds 1 or 3 channels and this has 4"):
        write(models.create("ward", channels=tuple("abcd")), name, tmp_path / "n")


def test_a_fits_own_residual_stands_beside(tmp_path: Path) -> None:
    table = fitter.load(Path(__file__).resolve().parents[2] / "data" / "tables" / "diffuse_plaster.csv")
    fit = fitter.fit(table, "lambert")
    told = write(fit, "gltf", tmp_path / "m.gltf", name="plaster")
    assert told.residuals["ours"] == fit.metrics["relative_rmse"]
    assert f"{fit.metrics['relative_rmse']:.1%}" in told.notes[0].message
    of_table = write(table, "gltf", tmp_path / "t.gltf")
    assert "differs from the table by" in of_table.notes[0].message


def test_gltf_finds_the_material_that_it_is(tmp_path: Path) -> None:
    """A metallic-roughness model comes back with its own parameters."""
    own = models.create(
        "metallic_roughness",
        channels=("R", "G", "B"),
        base_color=[0.8, 0.4, 0.2],
        metallic=0.3,
        roughness=0.5,
    )
    told = write(own, "gltf", tmp_path / "m.gltf")
    document = json.loads((tmp_path / "m.gltf").read_text())
    assert document["asset"]["version"] == "2.0"
    (material,) = document["materials"]
    found = material["pbrMetallicRoughness"]
    np.testing.assert_allclose(found["baseColorFactor"], [0.8, 0.4, 0.2, 1.0], rtol=1e-3)
    assert found["metallicFactor"] == pytest.approx(0.3, rel=1e-3)
    assert found["roughnessFactor"] == pytest.approx(0.5, rel=1e-3)
    assert material["extras"]["residuals"] == told.to_dict()["residuals"]


def test_materialx_validates(metal: ReflectanceModel, tmp_path: Path) -> None:
    mx: Any = pytest.importorskip("MaterialX", reason="NO MATERIALX: its documents are not validated")
    write(metal, "materialx", tmp_path / "m.mtlx", name=NASTY)
    library = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    document = mx.createDocument()
    mx.readFromXmlFile(document, str(tmp_path / "m.mtlx"))
    document.setDataLibrary(library)
    valid, why = document.validate()
    assert valid, why
    (material,) = document.getMaterialNodes()
    (shader,) = mx.getShaderNodes(material)
    assert shader.getNodeDef() is not None
    assert shader.getNodeDef().getNodeString() == "gltf_pbr"
    for given in shader.getInputs():
        assert shader.getNodeDef().getActiveInput(given.getName()) is not None


def test_mitsuba_has_the_formulas_that_were_fitted(mi: Any, metal: ReflectanceModel, tmp_path: Path) -> None:  # noqa: F811
    wi, wo = (w[::4] for w in compared_pairs(subject(metal)))
    for name in ("mitsuba-principled", "mitsuba-conductor"):
        found = write(metal, name, tmp_path / "m.xml", name=NASTY).residuals["parameters"]
        scene = mi.load_file(str(tmp_path / "m.xml"))
        del scene
        bsdf = _bsdf(mi, name, found)
        values = {key: np.asarray(value) for key, value in found.items()}
        if name == "mitsuba-principled":
            ours = principled(values, wi, wo)
        else:
            form = "torrance_sparrow:ggx:smith_separable:conductor:no_diffuse"
            ours = np.asarray(
                models.create(form, channels=("R", "G", "B"), ks=1.0, **values).evaluate(wi, wo)
            )
        np.testing.assert_allclose(evaluated(mi, bsdf, wi, wo) / wo[:, 2:], ours, rtol=2e-3, atol=1e-5)


def _bsdf(renderer: Any, name: str, found: dict[str, Any]) -> Any:
    """The BSDF of a snippet's numbers: a file's own is not handed out by Mitsuba's loader."""
    if name == "mitsuba-principled":
        return renderer.load_dict(
            {**found, "type": "principled", "base_color": {"type": "rgb", "value": found["base_color"]}}
        )
    return renderer.load_dict({
        "type": "roughconductor", "distribution": "ggx", "alpha": found["alpha"],
        "eta": {"type": "rgb", "value": found["eta"]}, "k": {"type": "rgb", "value": found["kappa"]},
    })  # fmt: skip


@pytest.mark.parametrize("name", ["ward:bounded:anisotropic", "ward:bounded:no_diffuse"])
def test_radiance_has_our_ward(name: str, tmp_path: Path) -> None:
    """A small sun on a plane: what rtrace sees is f_r times its irradiance."""
    tools: Any = pytest.importorskip("pyradiance", reason="NO RADIANCE: its material is not checked")
    model = make(name)
    told = write(model, "radiance", tmp_path / "m.rad", name="m")
    assert [note.code for note in told.notes] == ["exact"]
    wi = np.array([0.3, 0.2, 0.0])
    wi[2] = np.sqrt(1 - wi @ wi)
    size, radiance = 0.5, 1e6
    (tmp_path / "scene.rad").write_text(
        (tmp_path / "m.rad").read_text()
        + "m polygon floor 0 0 12 -9 -9 0 9 -9 0 9 9 0 -9 9 0\n"
        + f"void light sun 0 0 3 {radiance} {radiance} {radiance}\n"
        + f"sun source s 0 0 4 {wi[0]} {wi[1]} {wi[2]} {size}\n"
    )
    octree = tools.oconv(str(tmp_path / "scene.rad"))
    (tmp_path / "scene.oct").write_bytes(octree)
    rng = np.random.default_rng(2)
    wo = wi * [-1, -1, 1] + rng.normal(0, 0.15, (40, 3))
    wo[:, 2] = np.abs(wo[:, 2]) + 0.1
    wo /= np.linalg.norm(wo, axis=1)[:, None]
    rays = "".join(" ".join(map(repr, [*o, -o[0], -o[1], -o[2]])) + "\n" for o in wo.tolist())
    found = tools.rtrace(rays.encode(), str(tmp_path / "scene.oct"), header=False, params=["-ab", "0"])
    seen = np.array(found.decode().split(), float).reshape(-1, 3)
    irradiance = radiance * 2 * np.pi * (1 - np.cos(np.deg2rad(size / 2))) * wi[2]
    np.testing.assert_allclose(seen, np.asarray(model.evaluate(wi, wo)) * irradiance, rtol=0.02)


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def gone(name: str) -> Any:
        raise ImportError(name)

    lambert = subject(make("lambert"))
    monkeypatch.setattr(importlib, "import_module", gone)
    with pytest.raises(SpecError, match="pyradiance is not installed") as refused:
        target("klems").write(lambert, tmp_path / "m.xml")
    assert refused.value.remedy == "pip install brdf-fitter[renderers]"
