"""Plans: what is found, under which name, and what is refused before anything is fitted."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path
from typing import Any

import pytest

import fitter
from fitter.batch import batch_spec, plan, read_spec, schema
from fitter.errors import SpecError
from tests.batch.conftest import Write

DOCS = Path(__file__).parents[2] / "docs"


def _plan(*tables: Path | str, **keywords: Any) -> Any:
    return plan(batch_spec({"tables": [str(one) for one in tables], **keywords}))


def test_folders_patterns_archives_and_files(tmp_path: Path, write_table: Write):
    for name in ("a/one.csv", "a/two.csv", "b/c/three.csv"):
        write_table(tmp_path / name, 0.3)
    (tmp_path / "a" / ".hidden").write_text("x")
    with zipfile.ZipFile(tmp_path / "z.zip", "w") as archive:
        archive.write(tmp_path / "a" / "one.csv", "inner/one.csv")
        archive.write(tmp_path / "a" / "one.csv", "__MACOSX/one.csv")
    found = _plan(tmp_path / "a", tmp_path / "b" / "**" / "*.csv", tmp_path / "z.zip")
    assert sorted(unit.name for unit in found.units) == ["one", "three", "two", "z-inner-one"]
    assert {unit.format for unit in found.units} == {"delimited", "zip"}
    assert not found.refused


def test_a_measurement_in_several_files_is_one_unit(tmp_path: Path, write_table: Write):
    folder = tmp_path / "paint"
    fitter.write(fitter.load(write_table(tmp_path / "t.csv", 0.3)), folder, "pab-opto")
    found = _plan(folder)
    (unit,) = found.units
    assert (unit.name, unit.format, len(unit.paths)) == ("paint", "pab-opto", 3)
    assert unit.size == sum(path.stat().st_size for path in folder.iterdir())


def test_what_no_reader_takes_is_left_out_with_its_reason(tmp_path: Path, write_table: Write):
    write_table(tmp_path / "good.csv", 0.3)
    (tmp_path / "bad.bin").write_bytes(bytes(range(256)) * 8)
    found = _plan(tmp_path)
    assert [unit.name for unit in found.units] == ["good"]
    assert [one["table"] for one in found.refused] == ["bad"]
    assert found.refused[0]["error"]["code"]


def test_a_manifest_names_tables_and_how_they_are_read(tmp_path: Path, write_table: Write):
    write_table(tmp_path / "x" / "t.csv", 0.3)
    write_table(tmp_path / "y" / "t.csv", 0.3)
    manifest = tmp_path / "tables.csv"
    manifest.write_text("path,name,quantity\nx/t.csv,first,\ny/t.csv,second,reflectance_factor\n")
    found = plan(batch_spec({"manifest": str(manifest)}))
    assert {unit.name: dict(unit.reading) for unit in found.units} == {
        "first": {}, "second": {"quantity": "reflectance_factor"},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("content", "row", "says"),
    [
        ("file\nt.csv\n", 1, "column 'file'"),
        ("path,name\n,x\n", 2, "names no path"),
        ("path\nmissing.csv\n", 2, "is not there"),
        ("path,quantity\nt.csv,brightness\n", 2, "brightness"),
        ("path\n", None, "names no table"),
    ],
)
def test_a_bad_manifest(tmp_path: Path, write_table: Write, content: str, row: int | None, says: str):
    write_table(tmp_path / "t.csv", 0.3)
    manifest = tmp_path / "tables.csv"
    manifest.write_text(content)
    with pytest.raises(SpecError, match=says) as caught:
        plan(batch_spec({"manifest": str(manifest)}))
    assert (caught.value.file, caught.value.row) == (str(manifest), row)
    assert caught.value.remedy


def test_what_matches_nothing(tmp_path: Path):
    (tmp_path / "empty").mkdir()
    for pattern in (tmp_path / "*.csv", tmp_path / "gone.csv", tmp_path / "empty"):
        with pytest.raises(SpecError, match=str(pattern.name).replace("*", r"\*")) as caught:
            _plan(pattern)
        assert caught.value.code == "batch-no-tables"


def test_two_outputs_of_one_name(tmp_path: Path, write_table: Write):
    a, b = write_table(tmp_path / "a" / "T.csv", 0.3), write_table(tmp_path / "b" / "t.csv", 0.3)
    with pytest.raises(SpecError, match=r"a/T\.csv and .*b/t\.csv would both write") as caught:
        _plan(a, b)
    assert caught.value.code == "batch-same-name"


def test_a_specification_in_a_file(tmp_path: Path, write_table: Write):
    write_table(tmp_path / "t.csv", 0.3)
    yaml, toml = tmp_path / "b.yaml", tmp_path / "b.toml"
    yaml.write_text("tables: ['*.csv']\nmodels: [ward, 'lafortune:2']\nposterior: {ess: 100}\n")
    toml.write_text('tables = ["*.csv"]\nmodels = ["ward", "lafortune:2"]\nposterior = {ess = 100}\n')
    assert read_spec(yaml) == read_spec(toml)
    assert [unit.name for unit in plan(read_spec(yaml)).units] == ["t"]


def test_the_documented_specification(tmp_path: Path):
    page = (DOCS / "batch.md").read_text()
    (tmp_path / "b.yaml").write_text(re.findall(r"^```yaml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)[0])
    assert read_spec(tmp_path / "b.yaml").exports == ("glsl", "python")


def test_the_published_schema():
    """To renew it: print ``json.dumps(fitter.batch.schema(), indent=1)`` into it."""
    assert json.loads((DOCS / "batch.schema.json").read_text()) == schema()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("tables: [", "can't be read"),
        ("- a\n", "no mapping"),
        ("models: [ward]\n", "name tables"),
        ("tables: [t.csv]\nmodels: 3\n", "no list"),
        ("tables: [t.csv]\nmodels: [wart]\n", "wart"),
        ("tables: [t.csv]\nmodels: [ward, ward]\n", "twice"),
        ("tables: [t.csv]\nmodel: ward\n", "[Ee]xtra"),
        ("tables: [t.csv]\nexports: [maya]\n", "maya"),
        ("tables: [t.csv]\nreading: {quantity: light}\n", "light"),
    ],
)
def test_a_bad_specification(tmp_path: Path, text: str, says: str):
    file = tmp_path / "b.yaml"
    file.write_text(text)
    with pytest.raises(SpecError, match=says) as caught:
        read_spec(file)
    assert caught.value.file == str(file)
    assert caught.value.remedy
