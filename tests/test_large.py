"""Tables that stay in their file: the same samples, sums, findings and fits as in memory."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fitter
from fitter import reservoir
from fitter.cli.app import main
from fitter.errors import FitError, SpecError, TableError
from fitter.formats import write
from fitter.formats.read_options import read_options
from fitter.formats.stream import parts
from fitter.large import NONE_USABLE, LargeTable, open_large
from fitter.models import create
from fitter.repeats import RepeatEstimate, repeated
from fitter.reservoir import Reservoir
from fitter.spec import Select
from fitter.table import Table
from tests.bench.tables import pairs

ROWS = 3_000


def synthetic(rows: int = ROWS, sigma: bool = False) -> Table:
    """Ward with 1 % noise, RGB; some values negative, some missing, some geometries measured twice."""
    wi, wo = pairs(rows, 3)
    wi[100:110], wo[100:110] = wi[:10], wo[:10]
    model = create("ward", kd=[0.1, 0.2, 0.3], ks=0.05, alpha=0.2)
    rng = np.random.default_rng(1)
    value = np.asarray(model.evaluate(wi, wo)) * (1 + 0.01 * rng.standard_normal((rows, 3)))
    value[20:25, 1] *= -1
    value[30, 2] = np.nan
    return Table(
        wi=wi, wo=wo, value=value, sigma=np.abs(value) * 0.01 if sigma else None, symmetry="isotropic",
        duplicates="keep",
    )  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("large")
    for name, form in (("t.parquet", "parquet"), ("t.csv", "delimited")):
        write(synthetic(), where / name, form)
    return where


@pytest.mark.parametrize("name", ["t.parquet", "t.csv"])
@pytest.mark.parametrize("rows", [1, 177, ROWS, 10 * ROWS])
def test_the_parts_are_the_table(folder: Path, name: str, rows: int):
    whole = fitter.load(folder / name, duplicates="keep")
    rows = max(rows, 50) if name.endswith("csv") else max(rows, 20)
    found = list(parts(folder / name, read_options({}), rows))
    assert sum(part.rows for part in found) == ROWS
    tables = [part.table for part in found if part.table is not None]
    for field in ("wi", "wo", "value", "mask"):
        together = np.concatenate([getattr(table, field) for table in tables])
        np.testing.assert_array_equal(together, getattr(whole, field))
    assert {part.symmetry for part in found} == {"isotropic"}
    if rows < 1000:
        assert len(tables) > 1


@pytest.mark.parametrize("name", ["t.parquet", "t.csv"])
def test_the_sums_are_exact(folder: Path, name: str):
    whole = fitter.load(folder / name, duplicates="keep")
    large = open_large(folder / name, rows=250, sample=64 * 32)
    totals, value = large.totals, whole.value[whole.mask]
    assert (len(large), large.usable, totals.negative) == (len(whole), int(whole.mask.sum()), 5)
    assert large.metadata.masked == whole.metadata.masked
    np.testing.assert_array_equal([totals.lowest, totals.highest], [value.min(axis=0), value.max(axis=0)])
    np.testing.assert_allclose(totals.mean, value.mean(axis=0), rtol=1e-12)
    assert totals.spread == pytest.approx(np.square(value - value.mean(axis=0)).sum(), rel=1e-11)
    assert totals.repeats.exact
    assert totals.repeats.number == int(repeated(whole.wi[whole.mask], whole.wo[whole.mask]).sum()) == 10
    assert (large.symmetry, large.channels) == (whole.symmetry, whole.channels)
    np.testing.assert_allclose(large.domain.theta_i, whole.domain.theta_i, atol=1e-12)
    np.testing.assert_allclose(large.domain.theta_o, whole.domain.theta_o, atol=1e-12)
    assert large.weight.sum() == pytest.approx(large.usable)
    again = open_large(folder / name, rows=250, sample=64 * 32)
    np.testing.assert_array_equal(large.sample.value, again.sample.value)
    assert large.hash == again.hash


def test_a_sample_with_room_for_all_is_the_table(folder: Path):
    whole = fitter.load(folder / "t.parquet", duplicates="keep")
    large = open_large(folder / "t.parquet", rows=250, sample=ROWS * reservoir.STRATA)
    assert set(large.weight.tolist()) == {1.0}
    assert sorted(large.sample.value.tolist()) == sorted(whole.value[whole.mask].tolist())


@pytest.mark.long
def test_fits_agree(folder: Path):
    """The passes see the same samples; only the order of the sums, and where they start, differ."""
    whole = fitter.load(folder / "t.parquet", duplicates="keep")
    ours = fitter.fit(whole, "ward", metric="cosine")
    large = open_large(folder / "t.parquet", rows=400, sample=128 * 32)
    assert len(large.sample) < 0.9 * large.usable
    theirs = fitter.fit(large, "ward", metric="cosine")
    for name, estimate in ours.parameters.items():
        u = np.asarray(estimate.standard_uncertainty)
        assert (np.abs(theirs.parameters[name].value - estimate.value) < 2e-3 * u).all()
        np.testing.assert_allclose(theirs.parameters[name].standard_uncertainty, u, rtol=1e-4)
    assert theirs.metrics["rmse"] == pytest.approx(ours.metrics["rmse"], rel=1e-5)
    assert theirs.metrics["r2"] == pytest.approx(ours.metrics["r2"], rel=1e-8)
    assert theirs.table["fitted"] == ours.table["fitted"]
    assert theirs.table["out_of_core"]["sample"] == len(large.sample)
    near = Select(theta_i_max_deg=50.0)
    a, b = (fitter.fit(table, "ward", metric="cosine", select=near) for table in (whole, large))
    assert a.table["left_out"] == b.table["left_out"]
    assert b.parameters["alpha"].value == pytest.approx(a.parameters["alpha"].value, rel=1e-6)


def test_a_file_that_changes_under_a_fit(folder: Path, tmp_path: Path):
    path = tmp_path / "t.parquet"
    path.write_bytes((folder / "t.parquet").read_bytes())
    large = open_large(path, rows=400, sample=128 * 32)  # a sample of all would need no pass over the file
    write(synthetic(ROWS - 5), path, "parquet")
    with pytest.raises(FitError) as caught:
        fitter.fit(large, "ward", metric="cosine")
    assert caught.value.code == "file-changed"


def test_a_part_without_a_usable_sample(tmp_path: Path):
    table = synthetic()
    value = table.value.copy()
    value[500:1000] = -1.0
    write(Table(wi=table.wi, wo=table.wo, value=value, symmetry="isotropic"), tmp_path / "t", "parquet")
    large = open_large(tmp_path / "t", rows=500)
    assert large.metadata.masked[NONE_USABLE] == 500
    assert large.usable == ROWS - 500 - 6
    assert fitter.check(large)["samples"].numbers["masked"][NONE_USABLE] == 500


def test_refused(folder: Path, tmp_path: Path):
    with pytest.raises(TableError) as caught:
        open_large(folder / "t.parquet", item="a")
    assert caught.value.parameter == "item"
    write(synthetic(), tmp_path / "t.nc", "netcdf")
    with pytest.raises(TableError) as caught:
        open_large(tmp_path / "t.nc")
    assert caught.value.code == "table-not-in-parts"
    rows = ["theta_i_deg,theta_o_deg,dphi_deg,brdf,wavelength_nm", "30,40,0,1,500", "30,40,0,1,600", ""]
    (tmp_path / "t.csv").write_text("\n".join(rows))
    with pytest.raises(TableError) as caught:
        open_large(tmp_path / "t.csv")
    assert caught.value.code == "table-several"
    lines = (folder / "t.csv").read_text().splitlines()
    cells = lines[2000].split(",")
    lines[2000] = ",".join([*cells[:-1], "wrong"])
    (tmp_path / "t.csv").write_text("\n".join([*lines, ""]))
    with pytest.raises(TableError) as caught:
        open_large(tmp_path / "t.csv", rows=100)
    assert (caught.value.code, caught.value.row, caught.value.file) == ("table-not-a-number", 2001, "t.csv")


def test_check_counts_all_and_judges_the_sample(folder: Path):
    large = open_large(folder / "t.parquet", rows=400)
    found = fitter.check(large)
    assert found.samples == ROWS
    assert found["negatives"].numbers["samples"] == 5
    assert found["repeatability"].numbers == {"repeats": 10, "exact": True, "looked_at": large.usable}
    assert not found["fill_values"].judged
    assert found["samples"].verdict == "notice"
    whole = fitter.check(fitter.load(folder / "t.parquet", duplicates="keep"))
    assert found["convention"].verdict == whole["convention"].verdict
    assert {f.name for f in found.findings} - {f.name for f in whole.findings} == {"samples"}


def test_the_command(folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path):
    path = str(folder / "t.parquet")
    assert main(["check", path, "--out-of-core", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["samples"] == ROWS
    call = ["fit", path, "--model", "ward", "--metric", "cosine", "--out-of-core"]
    assert main([*call, "--out", str(tmp_path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["table"]["source"]["out_of_core"]
    assert main([*call, "--compress", "0.1"]) == 2
    capsys.readouterr()
    assert main(["report", str(tmp_path / "ward.json"), "--out", str(tmp_path), "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "table-too-large"


@given(st.integers(0, 2**32), st.integers(1, 40), st.integers(2, 5))
def test_a_reservoir_is_full_or_holds_all(seed: int, room: int, pieces: int):
    wi, wo = pairs(400, 5)
    table = Table(wi=wi, wo=wo, value=np.arange(1.0, 401.0), symmetry="isotropic")
    held = Reservoir(room, seed)
    for rows in np.array_split(np.arange(400), pieces):
        held.add(Table(wi=wi[rows], wo=wo[rows], value=table.value[rows], symmetry="isotropic"))
    assert held.rows is not None
    counts = np.bincount(reservoir.strata(table.wi, table.wo), minlength=reservoir.STRATA)
    kept = np.bincount(held.rows[:, 1].astype(int), minlength=reservoir.STRATA)
    np.testing.assert_array_equal(kept, np.minimum(counts, room))
    assert len(np.unique(held.rows[:, 8])) == len(held.rows)
    np.testing.assert_allclose(held.weight.sum(), 400)


def test_every_row_is_as_likely_as_another():
    """Of 400 rows in two parts, 4 a stratum: over 1000 seeds each row's frequency is binomial."""
    wi, wo = pairs(400, 5)
    value = np.arange(400.0) + 1
    halves = [
        Table(wi=wi[rows], wo=wo[rows], value=value[rows], symmetry="isotropic")
        for rows in (slice(0, 150), slice(150, 400))
    ]
    seen = np.zeros(400)
    for seed in range(1000):
        held = Reservoir(4, seed)
        for half in halves:
            held.add(half)
        assert held.rows is not None
        seen[held.rows[:, 8].astype(int) - 1] += 1
    stratum = reservoir.strata(wi, wo)
    p = np.minimum(4 / np.bincount(stratum)[stratum], 1.0)
    spread = np.sqrt(1000 * p * (1 - p))
    z = (seen - 1000 * p)[spread > 0] / spread[spread > 0]
    assert np.abs(z).max() < 5
    assert 0.8 < z.std() < 1.2
    assert (seen[spread == 0] == 1000).all()


def test_repeats_are_estimated_from_a_share_of_the_geometries():
    rng = np.random.default_rng(7)
    w = rng.standard_normal((2, 60_000, 3))
    w /= np.linalg.norm(w, axis=-1, keepdims=True)
    pick = rng.integers(0, 60_000, 100_000)
    exact = int(repeated(w[0, pick], w[1, pick]).sum())
    estimate = RepeatEstimate(most=8192)
    for some in np.array_split(pick, 7):
        estimate.add(w[0, some], w[1, some])
    assert not estimate.exact
    assert estimate.looked_at <= 8192
    assert estimate.number == pytest.approx(exact, rel=0.06)


def test_a_large_table_is_exported():
    assert fitter.LargeTable is LargeTable
    assert SpecError is fitter.SpecError
