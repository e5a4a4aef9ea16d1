"""Batches run, stopped, resumed, on real workers, and compared."""

from __future__ import annotations

import json
import re
import signal
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pyarrow.parquet
import pytest

import fitter
from fitter.batch import Plan, batch_spec, compare, estimate, page, plan, run, svg
from fitter.cli.reading import table_of
from fitter.errors import FitError, SpecError
from fitter.formats import ReadOptions
from fitter.progress import Cancelled
from tests.batch.conftest import Write, rows_without_times, summary_rows

#: Quick to fit, quick to compile.
SPEC = {"models": ["oren_nayar", "ward"], "report": False}


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory, write_table: Write) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    for k, albedo in enumerate((0.2, 0.5, 0.8)):
        write_table(folder / f"t{k}.csv", albedo)
    (folder / "unreadable.csv").write_text("theta_i_deg,theta_o_deg\n1,2\n")
    return folder


def _planned(tables: Path, **keywords: Any) -> Plan:
    return plan(batch_spec({"tables": [str(tables)], **SPEC, **keywords}))


@pytest.fixture(scope="module")
def done(tables: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A batch of three good tables and a bad one, done in this process."""
    out = tmp_path_factory.mktemp("batch")
    found = run(_planned(tables), out, workers=1)
    assert (found.done, found.kept, found.failed) == (4, 0, 1)
    return out


def test_results_summary_and_index(done: Path):
    rows = summary_rows(done)
    assert [(row["table"], row["model"], row["status"]) for row in rows] == [
        *((f"t{k}", model, "converged") for k in range(3) for model in ("oren_nayar", "ward")),
        ("unreadable", "", "failed"),
    ]  # fmt: skip
    assert "value" in rows[-1]["error"]
    fit = fitter.load_fit(done / "tables" / "t1" / "oren_nayar.json")
    row = rows[2]
    assert float(row["rho[value]"]) == pytest.approx(float(fit.parameters["rho"].value[0]), rel=1e-12)
    u = float(fit.parameters["rho"].standard_uncertainty[0])
    assert float(row["u(rho[value])"]) == pytest.approx(u, rel=1e-12)
    assert abs(float(row["rho[value]"]) - 0.5) < 5 * u
    packed = pyarrow.parquet.read_table(done / "summary.parquet").to_pylist()
    assert [one["rmse"] for one in packed[:6]] == [float(one["rmse"]) for one in rows[:6]]
    assert packed[-1]["rmse"] is None
    shown = (done / "index.html").read_text()
    assert shown.count("<tr data-status") == 4
    assert 'src="tables/t0/picture.svg"' in shown
    drawn = ElementTree.parse(done / "tables" / "t0" / "picture.svg").getroot()
    assert len(drawn.findall("{*}g")) == 2
    numbers = re.findall(r"[-\d.]+", " ".join(str(one.get("d")) for one in drawn.findall(".//{*}path")))
    assert len(numbers) > 200
    assert all(0 <= float(number) <= svg.WIDTH for number in numbers)


def _record(name: str, relative: float, status: str = "converged") -> dict[str, Any]:
    fit = {
        "model": "ward", "file": "ward.json", "status": status, "warnings": [],
        "metrics": {"rmse": relative, "relative_rmse": relative},
    }  # fmt: skip
    table = {
        "table": name, "folder": f"tables/{name}", "fits": [fit], "best": "ward", "notes": [], "usable": 1,
        "seconds": 0.1,
    }  # fmt: skip
    return {"unit": {"name": name}, "error": None, "tables": [table]}


def test_the_index_shows_the_worst_of_many():
    index = page.Index(reports=True, most=4)
    for k in range(20):
        index.add(_record(f"t{k:02}", 0.01 * (k % 10)))
    index.add(_record("odd", 0.001, "not_converged"))
    error = {"message": "is no number", "row": 7}
    index.add({"unit": {"name": "broken"}, "error": error, "tables": []})
    for k in range(20, 40):
        index.add(_record(f"t{k:02}", 0.001))
    text = index.render()
    assert re.findall(r'<tr data-status="[\w ]+">\s*<td>(?:<a [^>]*>)?(\w+)', text) == [
        "broken", "odd", "t09", "t19",
    ]  # fmt: skip
    assert "Batch of 42 tables" in text
    assert "40 converged, 1 failed, 1 not converged" in text
    assert "the 4 worst" in text
    assert "row 7: is no number" in text


def test_done_again_is_not_done_again(done: Path, tables: Path):
    before = {path: path.stat().st_mtime_ns for path in done.glob("tables/t*/*.json")}
    found = run(_planned(tables), done, workers=1)
    assert (found.done, found.kept) == (1, 3)  # the failed one may have been mended
    assert {path: path.stat().st_mtime_ns for path in done.glob("tables/t*/*.json")} == before


def test_what_has_changed_is_done_again(tables: Path, tmp_path: Path, write_table: Write):
    table = write_table(tmp_path / "t.csv", 0.3)
    spec: dict[str, Any] = {"tables": [str(table)], "models": ["oren_nayar"], "report": False}
    out = tmp_path / "out"
    assert run(plan(batch_spec(spec)), out, workers=1).done == 1
    assert run(plan(batch_spec(spec)), out, workers=1).kept == 1
    assert run(plan(batch_spec({**spec, "metric": "cosine"})), out, workers=1).done == 1
    write_table(table, 0.4)
    assert run(plan(batch_spec({**spec, "metric": "cosine"})), out, workers=1).done == 1


def test_stopped_and_resumed(tables: Path, tmp_path: Path, done: Path):
    def stop(share: float, what: str) -> None:
        if share > 0.4:
            raise Cancelled

    with pytest.raises(Cancelled):
        run(_planned(tables), tmp_path, workers=1, progress=stop)
    assert 1 <= len({row["table"] for row in summary_rows(tmp_path)}) < 4
    again = run(_planned(tables), tmp_path, workers=1)
    assert again.kept >= 1
    assert rows_without_times(tmp_path) == rows_without_times(done)


@pytest.mark.long
def test_workers_of_its_own(tables: Path, tmp_path: Path, done: Path):
    """The same numbers as in one process, each once."""
    found = run(_planned(tables), tmp_path, workers=2)
    assert (found.done, found.failed) == (4, 1)
    assert rows_without_times(tmp_path) == rows_without_times(done)


def test_a_scheduler_that_is_not_there(tables: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("fitter.batch.cluster._PATIENCE", 0.5)
    with pytest.raises(SpecError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:1"):
        run(_planned(tables), tmp_path / "out", scheduler="tcp://127.0.0.1:1")
    for address in ("nonsense", "tcp://127.0.0.1"):
        with pytest.raises(SpecError, match=f"no Dask scheduler answers at {address}"):
            run(_planned(tables), tmp_path / "out", scheduler=address)


def test_a_full_disk_says_so_and_loses_nothing(tables: Path, tmp_path: Path):
    """A real limit: no file may grow beyond a few kilobytes."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    out = tmp_path / "out"
    what = _planned(tables)
    out.mkdir()
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4000, before[1]))
        with pytest.raises(FitError, match=r"can't be written|is full") as caught:
            run(what, out, workers=1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert caught.value.code in ("output-unwritable", "disk-full")
    assert not [path for path in out.rglob("*.json") if _broken(path)]
    assert run(what, out, workers=1).failed == 1


def _broken(path: Path) -> bool:
    try:
        json.loads(path.read_text())
    except ValueError:
        return True
    return False


def test_an_estimate_is_measured(tables: Path):
    found = estimate(_planned(tables), workers=2)
    assert (found.tables, found.fits) == (4, 8)
    assert found.seconds > 0
    assert found.memory > 50e6
    assert 1 <= len(found.tried) <= 3


def test_posterior_and_export_of_the_best(tmp_path: Path, write_table: Write):
    table = write_table(tmp_path / "t.csv", 0.3)
    posterior = {"ess": 50, "max_samples": 200, "rhat": 1.2, "budget_seconds": 20}
    spec = batch_spec(
        {
            "tables": [str(table)],
            "models": "oren_nayar",
            "posterior": posterior,
            "report": False,
            "exports": ["python"],
        }
    )
    assert run(plan(spec), tmp_path / "out", workers=1).failed == 0
    place = tmp_path / "out" / "tables" / "t"
    assert {"posterior.json", "python.py", "oren_nayar.json"} <= {path.name for path in place.iterdir()}
    (row,) = summary_rows(tmp_path / "out")
    assert row["posterior"]
    assert float(row["lower95(rho[value])"]) < float(row["rho[value]"]) < float(row["upper95(rho[value])"])


def test_tables_are_found_again_wherever_they_came_from(tmp_path: Path, write_table: Write):
    """In an archive, in a file of several tables, in a folder of one measurement's files."""
    for name, albedo in (("a", 0.3), ("b", 0.6)):
        write_table(tmp_path / f"{name}.csv", albedo)
    with zipfile.ZipFile(tmp_path / "z.zip", "w") as archive:
        for name in ("a", "b"):
            archive.write(tmp_path / f"{name}.csv", f"in/{name}.csv")
    lines = [(tmp_path / f"{name}.csv").read_text().splitlines() for name in ("a", "b")]
    both = [f"{lines[0][0]},item", *(f"{row},{'ab'[k]}" for k in range(2) for row in lines[k][1:])]
    (tmp_path / "both.csv").write_text("\n".join([*both, ""]))
    fitter.write(fitter.load(tmp_path / "a.csv"), tmp_path / "spread", "pab-opto")
    found = plan(
        batch_spec(
            {
                "tables": [str(tmp_path / name) for name in ("z.zip", "both.csv", "spread")],
                "models": ["oren_nayar"], "report": False,
            }
        )
    )  # fmt: skip
    out = tmp_path / "out"
    assert run(found, out, workers=1).failed == 0
    fits = sorted(out.glob("tables/**/oren_nayar.json"))
    assert [str(path.parent.relative_to(out / "tables")) for path in fits] == [
        "both/a", "both/b", "spread", "z-in-a", "z-in-b",
    ]  # fmt: skip
    for path in fits:
        fit = fitter.load_fit(path)
        opened = table_of(fit.table, None, ReadOptions(), result=path)
        assert opened.table.hash == fit.table["hash"], path


def test_a_mark_outside_is_not_drawn():
    panel = svg.Panel("t", (0.0, 10.0), (0.0, 1.0), [], [])
    panel.mark(10.1)
    assert not panel.parts
    panel.mark(5.0)
    assert len(panel.parts) == 1


def test_a_table_that_breaks_its_reader_is_no_end_of_the_batch(
    tmp_path: Path, write_table: Write, monkeypatch: pytest.MonkeyPatch
):
    """Counted as one table; when its turn comes its record says what happened."""
    spec = {"tables": [str(write_table(tmp_path / "t.csv", 0.3))], "models": ["lambert"], "report": False}
    what = plan(batch_spec(spec))

    def breaks(_unit: object) -> None:
        raise ZeroDivisionError("not foreseen")

    monkeypatch.setattr("fitter.batch.working._opened", breaks)
    found = run(what, tmp_path / "out", workers=2)
    assert (found.done, found.failed) == (1, 1)
    assert "not foreseen" in summary_rows(tmp_path / "out")[0]["error"]


def test_items_of_any_name_have_folders_of_their_own(tmp_path: Path, write_table: Write):
    """Also one named like the file, and names that only differ in case or are taken."""
    items = ("paint", "a", "A", "a-1", "unit.json")
    rows = write_table(tmp_path / "t.csv", 0.3).read_text().splitlines()
    text = [f"{rows[0]},item", *(f"{row},{item}" for item in items for row in rows[1:])]
    (tmp_path / "paint.csv").write_text("\n".join([*text, ""]))
    spec = {"tables": [str(tmp_path / "paint.csv")], "models": ["lambert"], "report": False}
    out = tmp_path / "out"
    assert run(plan(batch_spec(spec)), out, workers=1).failed == 0
    assert [row["table"] for row in summary_rows(out)] == [
        "paint/paint", "paint/a-1-1", "paint/A-2", "paint/a-1", "paint/unit.json-4",
    ]  # fmt: skip
    for item, row in zip(items, summary_rows(out), strict=True):
        path = out / row["folder"] / "lambert.json"
        opened = table_of(fitter.load_fit(path).table, None, ReadOptions(), result=path)
        assert opened.table.metadata.provenance["item"] == item


def test_a_member_that_claims_too_much_fails_alone(
    tmp_path: Path, write_table: Write, monkeypatch: pytest.MonkeyPatch
):
    write_table(tmp_path / "small.csv", 0.3)
    with zipfile.ZipFile(tmp_path / "z.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(tmp_path / "small.csv", "small.csv")
        archive.writestr("bomb.csv", bytes(100_000))
    monkeypatch.setattr("fitter.formats.archives.MAX_UNPACKED", 50_000)
    spec = {"tables": [str(tmp_path / "z.zip")], "models": ["oren_nayar"], "report": False}
    assert run(plan(batch_spec(spec)), tmp_path / "out", workers=1).failed == 1
    errors = {row["table"]: row["error"] for row in summary_rows(tmp_path / "out")}
    assert errors["z-small"] == ""
    assert "claims to unpack" in errors["z-bomb"]


def test_batches_and_fits_compared(done: Path, tables: Path, tmp_path: Path):
    same = compare(done, done)
    assert (len(same.changed), same.compared) == (0, 6)
    run(_planned(tables, seed=5, metric="relative"), tmp_path / "b", workers=1)
    other = compare(done, tmp_path / "b")
    assert (other.compared, other.parameters) == (6, same.parameters)
    a, b = (done / "tables" / f"t{k}" / "oren_nayar.json" for k in (0, 1))
    (albedo,) = [one for one in compare(a, b).changed if one["what"] == "rho[value]"]
    assert albedo["score"] > 20
    u = np.hypot(albedo["u_a"], albedo["u_b"])
    assert albedo["score"] == pytest.approx((albedo["b"] - albedo["a"]) / u)
    with pytest.raises(SpecError, match="one is a batch"):
        compare(done, a)
    with pytest.raises(SpecError, match="holds no batch"):
        compare(done, tmp_path)
