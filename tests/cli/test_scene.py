"""``scene``: an example, pictures, and what is said of bad calls."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Run


@pytest.fixture
def example(run: Run, tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    assert run("scene", "example", "--out", path).status == 0
    path.write_text(
        path.read_text().replace("width = 96", "width = 24").replace("height = 64", "height = 16")
    )
    return path


def test_render(run: Run, example: Path, tmp_path: Path, fits: Path, plaster: Path) -> None:
    document = run("scene", "render", example, "--samples", 2, "--out", tmp_path / "out", "--json").document
    assert document["kind"] == "brdf-fitter/picture"
    assert (document["samples"], document["stopped"]) == (2, "samples")
    assert [Path(path).name for path in document["paths"]] == ["picture.exr", "picture.png", "picture.json"]
    assert json.loads((tmp_path / "out" / "picture.json").read_text())["mean"] == document["mean"]
    text = example.read_text()
    head, rest = text.split("[materials.ball]", 1)
    for material in (f'fit = "{fits / "ward.json"}"', f'table = "{plaster}"'):
        example.write_text(f"{head}[materials.ball]\n{material}\n" + rest[rest.index("\n\n") :])
        ran = run("scene", "render", example, "--samples", 2)
        assert "error" in ran.out


def test_bad_calls(run: Run, example: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text(example.read_text().replace("radius", "radiis"))
    for words, said in (
        (["render"], "needs a scene"), (["render", tmp_path / "no.toml"], "can't be read"),
        (["render", broken], "radiis"), (["render", example, "--samples", "0"], "samples"),
    ):  # fmt: skip
        ran = run("scene", *words, "--json")
        assert ran.status == 2
        assert said in json.dumps(ran.document["error"]), words


def test_plan(run: Run, example: Path, tmp_path: Path) -> None:
    document = run("scene", "plan", example, "--tolerance", "20%", "--out", tmp_path / "p", "--json").document
    assert document["kind"] == "brdf-fitter/plan"
    assert document["tolerance"] == 0.2
    assert json.loads((tmp_path / "p" / "plan.json").read_text())["decisions"] == document["decisions"]
    ran = run(
        "scene", "render", example, "--samples", 2, "--plan", "--tolerance", "20%", "--out", tmp_path / "r"
    )
    assert "operations a sample" in ran.out
    assert "off: directions stay within" in ran.out
    assert (tmp_path / "r" / "picture.plan.json").exists()


def test_compare(run: Run, example: Path, tmp_path: Path, fits: Path, plaster: Path) -> None:
    words = ["scene", "compare", example, "--material", "ball", "--table", plaster, "--fit"]
    ran = run(*words, fits / "oren_nayar.json", "--samples", 4, "--out", tmp_path / "c", "--json")
    document = ran.document
    assert document["kind"] == "brdf-fitter/scene-comparison"
    assert [one["channel"] for one in document["numbers"]] == ["R", "G", "B"]
    # Plaster is what this model is for.
    assert all(one["error_without_noise"] < 0.1 and one["psnr_db"] > 20 for one in document["numbers"])
    assert (tmp_path / "c" / "compare.png").read_bytes().startswith(b"\x89PNG")
    words[words.index("ball")] = "bowl"
    ran = run(*words, fits / "oren_nayar.json", "--json")
    assert (ran.status, "tile, ball" in ran.document["error"]["remedy"]) == (2, True)
