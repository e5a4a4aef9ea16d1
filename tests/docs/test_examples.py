"""The programs of examples/ run, and say what their own words promise."""

from __future__ import annotations

import csv
import math
import re
import runpy
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """What an example prints, called as a person does."""
    monkeypatch.setattr(sys, "argv", [name, *words])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return capsys.readouterr().out


def test_all_are_tested_and_in_the_index() -> None:
    index = (EXAMPLES.parent / "docs" / "index.md").read_text()
    for path in EXAMPLES.glob("*.py"):
        assert f"`{path.name}`" in index
        assert f'"{path.name}"' in Path(__file__).read_text()


def test_uncertainty_budget(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The paint's misfit is far above its noise, and the combined uncertainty has both."""
    said = run("uncertainty_budget.py", monkeypatch, capsys)
    head = next(line for line in said.splitlines() if line.strip().startswith("parameter")).split()
    assert head == [
        "parameter", "y", "noise", "scale", "theta_i", "theta_o", "phi", "discrepancy", "u", "k", "U",
    ]  # fmt: skip
    red = next(line for line in said.splitlines() if line.strip().startswith("kd[R]"))
    noise, scale, *angles, discrepancy = (float(share) for share in re.findall(r"(\S+) %", red))
    # As docs/uncertainty.md has it; the scale is the table's own.
    assert scale == 0.5
    assert (round(noise, 2), round(discrepancy, 1)) == (0.04, 4.8)
    assert len(angles) == 3
    assert max(angles) < 0.005


def test_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    said = run("look.py", monkeypatch, capsys, "--out", str(tmp_path / "look"))
    made = {path.name for path in (tmp_path / "look").iterdir()}
    assert {"paint.gltf", "paint.mtlx", "paint.glsl", "compare.png"} <= made
    assert said.count("A refit as") == 2
    assert "pixels are" in said


def test_folder_of_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "night"
    said = run("folder_of_tables.py", monkeypatch, capsys, "--out", str(out))
    assert said.count("2 done") == 2
    with (out / "cbrt" / "summary.csv").open(newline="") as file:
        assert [row["table"] for row in csv.DictReader(file)] == ["diffuse_plaster", "glossy_paint"]
    assert re.search(r"glossy_paint, oren_nayar: converged, relative rmse \S+ !", said)
    assert not re.search(r"diffuse_plaster, .* !", said)
    again = run("folder_of_tables.py", monkeypatch, capsys, "--out", str(out))
    assert again.count("0 done") == again.count("2 were there") == 2


def test_with_tables_of_one_s_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder in which one table can't be read, and estimates of 0 in a table that states its scale."""
    tables = tmp_path / "tables"
    tables.mkdir()
    rows = [
        f"{theta_i},{theta_o},{dphi},{0.1 * (0.6 + 0.4 * math.cos(math.radians(theta_o)))}"
        for theta_i in (10, 30, 50, 70) for theta_o in range(0, 80, 10) for dphi in (0, 90, 180)
    ]  # fmt: skip
    head = ["# scale_uncertainty: 0.005", "theta_i_deg,theta_o_deg,dphi_deg,brdf"]
    (tables / "matte.csv").write_text("\n".join([*head, *rows, ""]))
    (tables / "broken.csv").write_text("\n".join([*head, *rows, "1,2,3,four", ""]))
    said = run("folder_of_tables.py", monkeypatch, capsys, str(tables), "--out", str(tmp_path / "night"))
    assert re.search(r"broken: failed, .*is not a number !", said)
    assert re.search(r"matte, oren_nayar: converged, relative rmse \S+$", said, re.MULTILINE)
    said = run("uncertainty_budget.py", monkeypatch, capsys, str(tables / "matte.csv"))
    assert re.search(r"^ +ks\[value\] +0 +- +-", said, re.MULTILINE)
