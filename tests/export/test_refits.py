"""Refits: the target's own reader takes the file, the formula is the target's, the residual is told."""

from __future__ import annotations

import importlib
import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fitter
from fitter import models
from fitter.errors import SpecError
from fitter.export import subject, target, write
from fitter.export.fidelity import compared_pairs
from fitter.export.openpbr import openpbr
from fitter.export.principled import principled
from fitter.models import ReflectanceModel
from tests.export.conftest import make
from tests.export.test_mitsuba import evaluated, mi  # noqa: F401 (a fixture)
from tests.export.test_sources import glslang

#: A material's name that would end a comment, a line or a string in one language or another.
NASTY = 'worn --> <brass> */ \\ " & \x01 é\n\\'

REFITS = ("gltf", "materialx", "openpbr", "mitsuba-principled", "mitsuba-conductor", "radiance")


@pytest.fixture(scope="module")
def metal() -> ReflectanceModel:
    return models.create(
        "torrance_sparrow:ggx:smith:no_diffuse",
        channels=("R", "G", "B"),
        ks=1.0,
        f0=[0.9, 0.6, 0.3],
        alpha=0.2,
    )


@pytest.fixture(scope="module")
def brushed() -> ReflectanceModel:
    return models.create(
        "torrance_sparrow:ggx:smith:anisotropic:no_diffuse", channels=("R", "G", "B"), ks=1.0,
        f0=[0.9, 0.6, 0.3], alpha_x=0.3, alpha_y=0.15, psi=0.4,
    )  # fmt: skip


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


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "node", "source"),
    [("materialx", "gltf_pbr", "metal"), ("openpbr", "open_pbr_surface", "metal"),
     ("openpbr", "open_pbr_surface", "brushed")],
)  # fmt: skip
def test_materialx_validates(
    name: str, node: str, source: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """Its validator takes the document, and its generator of shaders makes one of it that compiles."""
    mx: Any = pytest.importorskip("MaterialX", reason="NO MATERIALX: its documents are not validated")
    write(request.getfixturevalue(source), name, tmp_path / "m.mtlx", name=NASTY)
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
    assert shader.getNodeDef().getNodeString() == node
    for given in shader.getInputs():
        assert shader.getNodeDef().getActiveInput(given.getName()) is not None
    generation = importlib.import_module("MaterialX.PyMaterialXGenShader")
    generator = importlib.import_module("MaterialX.PyMaterialXGenGlsl").GlslShaderGenerator.create()
    context = generation.GenContext(generator)
    for folder in mx.getDefaultDataSearchPath().asString().split(os.pathsep):
        context.registerSourceCodeSearchPath(mx.FilePath(folder))
        context.registerSourceCodeSearchPath(mx.FilePath(folder) / "libraries")
    made = generator.generate("m", shader, context).getSourceCode(generation.PIXEL_STAGE)
    (tmp_path / "m.frag").write_text(made)
    validator, environment = glslang()
    done = subprocess.run([validator, tmp_path / "m.frag"], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stdout[-4000:]


def test_openpbr_is_made_of_what_it_says(metal: ReflectanceModel) -> None:
    """A metal is Schlick's GGX but for what scatters twice, a base without an index is the diffuse model."""
    wi, wo = (w[::25] for w in compared_pairs(subject(metal), 1000))
    colour = np.array([0.9, 0.6, 0.3])
    values = {
        "base_color": colour, "specular_color": np.ones(3), "base_diffuse_roughness": np.array(0.3),
        "base_metalness": np.array(1.0), "specular_roughness": np.sqrt(0.2), "specular_ior": np.array(1.5),
    }  # fmt: skip
    ratio = openpbr(3)(values, wi, wo) / np.asarray(metal.evaluate(wi, wo))
    # What GGX of that width loses at a white metal: 1 - E, at most a tenth here.
    form = "torrance_sparrow:ggx:smith:none:no_diffuse"
    once = np.asarray(models.create(form, channels=("w",), ks=1.0, alpha=0.2).albedo(wo))
    h = (wi + wo) / np.linalg.norm(wi + wo, axis=1)[:, None]
    fresnel = colour + (1 - colour) * (1 - (h * wo).sum(axis=1)[:, None]) ** 5
    np.testing.assert_allclose(ratio, 1 + fresnel * (1 - once) / once, rtol=0.01)
    bare = {**values, "base_metalness": np.array(0.0), "specular_ior": np.array(1.0)}
    # A mirror-like interface without an index loses nothing but at grazing.
    eon = models.create("oren_nayar:eon", channels=("R", "G", "B"), rho=colour, sigma=0.3)
    high = wo[:, 2] > 0.8
    found = openpbr(3)(bare, wi[high], wo[high])
    np.testing.assert_allclose(found, eon.evaluate(wi[high], wo[high]), rtol=2e-3)


@pytest.mark.long
def test_openpbr_holds_a_brushed_surface(brushed: ReflectanceModel, tmp_path: Path) -> None:
    told = write(brushed, "openpbr", tmp_path / "m.mtlx")
    assert told.residuals["refit"] < 0.1
    found = told.residuals["parameters"]
    r, stretch = found["specular_roughness"], 1 - found["specular_roughness_anisotropy"]
    along = r * r * np.sqrt(2 / (1 + stretch**2))
    np.testing.assert_allclose([along, stretch * along], [0.3, 0.15], rtol=0.1)
    # The tangent lies along the rougher axis, 0.4 from x; MaterialX's rotate3d turns v to v c + (v x axis) s.
    amount = re.search(r'name="amount" type="float" value="([^"]+)"', (tmp_path / "m.mtlx").read_text())
    assert amount is not None
    angle, x = np.deg2rad(float(amount[1])), np.array([1.0, 0.0, 0.0])
    turned = x * np.cos(angle) + np.cross(x, [0.0, 0.0, 1.0]) * np.sin(angle)
    assert abs(turned @ [np.cos(0.4), np.sin(0.4), 0.0]) > 0.999


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
