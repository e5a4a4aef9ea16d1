"""Every verb at its work: what it prints, what it writes, and that the same seed gives the same."""

from __future__ import annotations

import csv
import hashlib
import json
import signal
import socket
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fitter
from fitter import datasets
from fitter.models import check
from fitter.quality import overview
from fitter.spec import OPTIONS, ModelSpec
from tests.cli.conftest import Run, process


def test_info(run: Run, plaster: Path) -> None:
    document = run("info", plaster, "--json").document
    assert document["kind"] == "brdf-fitter/table"
    assert document["hash"] == fitter.load(plaster).hash
    text = run("info", plaster).out
    assert "diffuse_plaster" in text
    assert "specular side" in text


def test_info_of_what_is_no_brdf(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "mirror.sdr"
    path.write_text("Source Measured\nTypeColorModel bw\nsigma 2\n0 60\nbw def 0.04 0.09 enddef\n")
    document = run("info", path, "--json").document
    assert (document["kind"], document["holds"]) == ("brdf-fitter/no-table", "specular reflectance")
    assert document["channels"][0]["specular_reflectance"] == [0.04, 0.09]
    shown = run("info", path)
    assert shown.status == 0
    assert "specular reflectance" in shown.out
    assert "0.09" in shown.out
    refused = run("fit", path, "--model", "ward", "--json")
    assert refused.status == 2
    assert refused.document["error"]["code"] == "table-specular-only"
    assert "no BRDF" in refused.document["error"]["message"]


def test_info_of_a_folder(run: Run, tmp_path: Path) -> None:
    run("datasets", "copy", "diffuse_plaster", "glossy_paint", "--out", tmp_path)
    document = run("info", tmp_path, "--json").document
    assert document["kind"] == "brdf-fitter/tables"
    assert [table["name"] for table in document["tables"]] == ["diffuse_plaster", "glossy_paint"]
    assert run("info", tmp_path, "--item", "glossy_paint", "--json").document["name"] == "glossy_paint"


def test_info_says_noise_and_blind_spots(run: Run, plaster: Path) -> None:
    document = run("info", plaster, "--json").document
    expected = overview(fitter.load(plaster))
    assert document["noise"] == expected["noise"]
    assert document["blind_spots"]["share"] == expected["blind_spots"]["share"]
    assert "picture" not in document
    text = run("info", plaster).out
    assert expected["noise"]["sentence"] in text
    assert all(sentence in text for sentence in expected["blind_spots"]["sentences"])


def test_info_draws(run: Run, tmp_path: Path, plaster: Path) -> None:
    document = run("info", plaster, "--plot", tmp_path / "new", "--json").document
    assert document["picture"] == str(tmp_path / "new" / "diffuse_plaster.png")
    assert Path(document["picture"]).read_bytes().startswith(b"\x89PNG")
    assert run("info", plaster, "--plot", tmp_path / "new").out.count("diffuse_plaster.png") == 1


def test_info_draws_every_table_under_a_name_of_its_own(run: Run, tmp_path: Path) -> None:
    rows = "theta_i_deg,theta_o_deg,dphi_deg,brdf,item\n" + "".join(
        f"30,{theta},180,0.{theta},{item}\n" for item in ("a/b", "a b", "A_b") for theta in (10, 20, 30)
    )
    (tmp_path / "several.csv").write_text(rows)
    tables = run("info", tmp_path / "several.csv", "--plot", tmp_path / "out", "--json").document["tables"]
    names = [Path(one["picture"]).name for one in tables]
    assert names == ["several_a_b.png", "several_a_b-2.png", "several_A_b-3.png"]
    assert sorted(names) == sorted(path.name for path in (tmp_path / "out").iterdir())
    (tmp_path / "file").write_text("x")
    refused = run("info", tmp_path / "several.csv", "--plot", tmp_path / "file", "--json")
    assert (refused.status, refused.document["error"]["parameter"]) == (2, "plot")


def test_info_takes_reading_options(run: Run, tmp_path: Path) -> None:
    table = tmp_path / "unnamed.csv"
    table.write_text("a,b,c,d,e\n10,0,20,180,0.1\n10,0,30,180,0.2\n20,0,30,180,0.2\n")
    assert run("info", table).status == 2
    meanings = {"a": "theta_i_deg", "b": "phi_i_deg", "c": "theta_o_deg", "d": "phi_o_deg", "e": "value"}
    columns = [word for pair in meanings.items() for word in ("--column", "=".join(pair))]
    document = run("info", table, *columns, "--quantity", "reflectance_factor", "--json").document
    assert document["samples"] == 3
    assert document["channels"][0]["max_per_sr"] == pytest.approx(0.2 / np.pi)


def test_fit_writes_results_that_read_back(run: Run, fits: Path, plaster: Path) -> None:
    assert sorted(path.name for path in fits.iterdir()) == ["oren_nayar.json", "ward.json"]
    result = fitter.load_fit(fits / "ward.json")
    assert result.status in ("converged", "not_converged", "not_identified")
    assert result.table["source"] == {"path": str(plaster.resolve()), "options": {}}
    assert result.table["hash"] == fitter.load(plaster).hash


def test_fit_of_one_model_prints_the_result_itself(
    run: Run, plaster: Path, fits: Path, tmp_path: Path
) -> None:
    ran = run("fit", plaster, "--model", "oren_nayar", "--json")
    assert ran.status == 0
    assert ran.document["kind"] == "brdf-fitter/fit"
    printed = tmp_path / "printed.json"
    printed.write_text(ran.out)
    again, first = fitter.load_fit(printed), fitter.load_fit(fits / "oren_nayar.json")
    for name, estimate in first.parameters.items():
        # The same seed, table and settings: the same fit to the last bit.
        np.testing.assert_array_equal(again.parameters[name].value, estimate.value)


def test_fit_of_several_models_prints_them_all(run: Run, plaster: Path) -> None:
    words = ["fit", plaster, "--model", "oren_nayar", "--model", "ward", "--fixed", "alpha=0.3"]
    document = run(*words, "--json").document
    assert document["kind"] == "brdf-fitter/fits"
    assert [fit["model"]["name"] for fit in document["fits"]] == ["oren_nayar", "ward"]
    assert document["failures"] == []
    # Oren-Nayar has no alpha: it is fitted freely.
    assert [fit["spec"]["fixed"] for fit in document["fits"]] == [{}, {"alpha": 0.3}]
    text = run(*words).out
    assert "kd[R]" in text
    assert "rho[B]" in text


def test_fit_that_fails_says_why(run: Run, tmp_path: Path) -> None:
    table = tmp_path / "tiny.csv"
    table.write_text("# quantity: brdf\ntheta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,brdf\n10,0,20,180,0.1\n")
    ran = run("fit", table, "--model", "ward", "--json")
    assert (ran.status, ran.document["error"]["code"]) == (1, "too-few-samples")
    ran = run("fit", table, "--out", tmp_path / "out", "--json")
    assert ran.status == 1
    assert {failure["model"] for failure in ran.document["failures"]} == set(fitter.models.FAMILIES)
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.long
def test_fit_auto_ranks_models_and_writes_the_best(run: Run, plaster: Path, tmp_path: Path) -> None:
    words = ("fit", plaster, "--model", "auto", "--candidates", "lambert,oren_nayar", "--folds", "4")
    document = run(*words, "--out", tmp_path, "--json").document
    assert document["kind"] == "brdf-fitter/fits"
    assert document["selection"]["folds"]["folds"] == 4
    ranking = document["selection"]["ranking"]
    assert {one["model"] for one in ranking} == {"lambert", "oren_nayar"}
    chosen = document["selection"]["chosen"]
    assert document["fits"][0]["spec"]["model"]["family"] == chosen
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "lambert.json", "oren_nayar.json", "selection.json"
    ]  # fmt: skip
    assert fitter.load_fit(tmp_path / f"{chosen}.json").evidence["selection"]["chosen"] == chosen
    shown = run(*words)
    assert shown.status == 0
    assert f"* {chosen}" in shown.out
    assert document["selection"]["sentences"][0] in shown.out
    assert run("report", tmp_path / f"{chosen}.json", "--out", tmp_path / "report").status == 0
    assert "How the model was chosen" in (tmp_path / "report" / "report.html").read_text()


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        ("--model", "auto", "--model", "ward"), ("--candidates", "ward"),
        ("--model", "auto", "--candidates", "x"), ("--model", "auto", "--candidates", "ward,ward"),
        ("--model", "auto", "--fixed", "alpha=0.1"),
        ("--folds", "4"), ("--model", "auto", "--folds", "2"),
    ],
)  # fmt: skip
def test_fit_auto_refuses_what_makes_no_sense(run: Run, plaster: Path, words: tuple[str, ...]) -> None:
    ran = run("fit", plaster, *words, "--json")
    assert ran.status == 2
    assert ran.document["error"]["message"]


def test_fit_of_a_compressed_table(run: Run, plaster: Path, tmp_path: Path) -> None:
    words = ["fit", plaster, "--model", "oren_nayar", "--compress", "0.01", "--out", tmp_path, "--json"]
    document = run(*words).document
    assert document["table"]["compressed"]["tolerance"] == 0.01
    assert document["table"]["source"]["compressed_to"] == 0.01
    # Its table is found again, compressed the same way.
    from fitter.cli.reading import table_of
    from fitter.formats import ReadOptions

    opened = table_of(document["table"], None, ReadOptions(), result="oren_nayar.json")
    assert opened.table.hash == document["table"]["hash"]


def test_compress_and_decompress(run: Run, plaster: Path, tmp_path: Path) -> None:
    small, text = tmp_path / "small.brdf", tmp_path / "again.csv"
    document = run("compress", plaster, "--tolerance", "0", "--out", small, "--json").document
    assert document["bytes"] == small.stat().st_size
    assert run("info", small, "--json").document["hash"] == fitter.load(plaster).hash
    assert run("info", small, "--quantity", "ccbrdf").status == 2
    document = run("decompress", small, "--out", text, "--json").document
    assert document["hash"] == fitter.load(plaster).hash == fitter.load(text).hash
    assert run("decompress", plaster, "--out", tmp_path / "no.csv").status == 2
    assert run("decompress", tmp_path / "missing", "--out", tmp_path / "no.csv").status == 2
    assert not (tmp_path / "no.csv").exists()
    assert "of the bound" in run("compress", plaster, "--tolerance", "0.05", "--out", small).out


def test_a_fit_to_a_subset_says_what_that_costs(run: Run, plaster: Path) -> None:
    words = ["fit", plaster, "--model", "oren_nayar", "--subset", "128", "--polish", "subset"]
    assert "standard errors" in run(*words).out
    stated = run(*words, "--json").document["evidence"]["selection_error"]
    assert set(stated) == {"rho[R]", "rho[G]", "rho[B]", "sigma"}
    assert all(value > 0.5 for value in stated.values())


def test_compress_to_the_noise_and_with_floors(run: Run, plaster: Path, tmp_path: Path) -> None:
    small = tmp_path / "small.brdf"
    document = run("compress", plaster, "--tolerance", "noise", "--out", small, "--json").document
    assert 0.001 < document["tolerance"] < 0.2
    container = run("info", small, "--json").document["container"]
    assert container["floor_per_sr"] == document["floor_per_sr"]
    assert container["bytes"] == document["bytes"] == small.stat().st_size
    words = ["compress", plaster, "--tolerance", "0.01", "--floor", "G=0.5", "--out", small, "--json"]
    floors = run(*words).document["floor_per_sr"]
    assert floors[1] == 0.5
    assert floors[0] != 0.5
    assert "container.tolerance" in run("info", small).out
    for floor, code in (("X=1", "unknown-channel"), ("R=-1", "bad-floor")):
        ran = run("compress", plaster, "--tolerance", "0.01", "--floor", floor, "--out", small, "--json")
        assert (ran.status, ran.document["error"]["code"]) == (2, code)
    assert run("compress", plaster, "--tolerance", "some", "--out", small).status == 2


def test_a_damaged_container_is_salvaged(run: Run, plaster: Path, tmp_path: Path) -> None:
    from fitter.compression import compress

    small, text = tmp_path / "small.brdf", tmp_path / "again.csv"
    table = fitter.load(plaster)
    packed = compress(table, 0.01, tile=200)
    data = bytearray(packed.to_bytes())
    data[bytes(data).index(packed.blocks["values 1"].data) + 3] ^= 1
    small.write_bytes(data)
    ran = run("decompress", small, "--out", text, "--json")
    assert (ran.status, ran.document["error"]["column"]) == (2, "values 1")
    assert "--salvage" in ran.document["error"]["remedy"]
    assert run("info", small).status == 2
    document = run("decompress", small, "--out", text, "--salvage", "--json").document
    assert list(document["damaged"]) == ["values 1"]
    assert 0 < document["usable"] < table.usable
    assert fitter.load(text).usable == document["usable"]


@pytest.mark.parametrize("source", ["table", "model"])
def test_sample(run: Run, plaster: Path, fits: Path, tmp_path: Path, source: str) -> None:
    origin = [plaster] if source == "table" else ["--model", fits / "ward.json"]
    words = ["sample", *origin, "--theta-i", "30", "-n", "200"]
    first = run(*words, "--seed", "1", "--json")
    assert first.status == 0, first.err
    assert first.out == run(*words, "--seed", "1", "--json").out
    assert first.out != run(*words, "--seed", "2", "--json").out
    document = first.document
    wo = np.array(document["samples"]["wo"])
    np.testing.assert_allclose(np.linalg.norm(wo, axis=1), 1, atol=1e-12)
    assert all(0 < albedo < 1 for albedo in document["albedo_estimate"])

    assert run(*words, "--seed", "1", "--out", tmp_path / "draws.npz").status == 0
    with np.load(tmp_path / "draws.npz") as draws:
        np.testing.assert_array_equal(draws["wo"], wo)
        assert draws["channels"].tolist() == ["R", "G", "B"]
    assert "samples" not in run(*words, "--seed", "1", "--out", tmp_path / "draws.csv", "--json").document
    with (tmp_path / "draws.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    np.testing.assert_array_equal([[float(row[f"wo_{x}"]) for x in "xyz"] for row in rows], wo)


def test_samples_too_many_to_print(run: Run, plaster: Path) -> None:
    ran = run("sample", plaster, "--theta-i", "30", "-n", 10**6, "--seed", "1", "--json")
    assert (ran.status, ran.document["error"]["parameter"]) == (2, "count")


def test_models(run: Run) -> None:
    document = run("models", "--json").document
    assert [model["family"] for model in document["models"]] == list(OPTIONS)
    assert not document["missing"]
    for model in document["models"]:
        expected = [parameter.to_dict() for parameter in fitter.models.parameter_table(model["name"])]
        assert model["parameters"] == expected
        assert model["summary"]
    assert {model["family"] for model in document["models"] if model["fitted"]} == set(fitter.models.FAMILIES)
    assert run("models", "lafortune:2", "--json").document["models"][0]["name"] == "lafortune:2"
    assert "log-uniform" in run("models", "ward").out
    assert run("models", "wood").status == 2


def test_models_check(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = run("models", "--check", "lambert", "--json")
    assert (ran.status, ran.document["ok"]) == (0, True)
    (model,) = ran.document["models"]
    assert {"reciprocity", "chi-square p", "cost float32"} <= {figure["name"] for figure in model["figures"]}

    def broken(spec: ModelSpec) -> None:
        raise ZeroDivisionError(spec.name)

    monkeypatch.setattr(check, "parameter_settings", broken)
    ran = run("models", "--check", "lambert")
    assert ran.status == 1
    assert "lambert: FAILED" in ran.out


def test_datasets(run: Run, tmp_path: Path) -> None:
    listed = run("datasets", "list", "--json").document["datasets"]
    assert {one["name"] for one in listed} == set(datasets.samples())
    text = run("datasets").out
    assert all(f"\n  {one['name']} " in text and one["description"] in text for one in listed)
    copied = run("datasets", "copy", "diffuse_plaster", "--out", tmp_path / "new", "--json").document["paths"]
    assert [hashlib.sha256(Path(path).read_bytes()).digest() for path in copied] == [
        hashlib.sha256(datasets.sample("diffuse_plaster").read_bytes()).digest()
    ]


@pytest.mark.long
def test_posterior_and_report(run: Run, fits: Path, tmp_path: Path) -> None:
    out = tmp_path / "posterior.json"
    words = ["posterior", fits / "oren_nayar.json", "--budget-seconds", "20", "--ess", "100", "--rhat", "1.1"]
    ran = run(*words, "--seed", "3", "--out", out, "--json")
    assert ran.status == 0, ran.err
    document = ran.document
    assert document["kind"] == "brdf-fitter/posterior"
    assert document == json.loads(out.read_bytes())
    assert (document["spec"]["seed"], document["spec"]["ess"]) == (3, 100)
    assert [path.name for path in tmp_path.iterdir()] == ["posterior.json"]  # no checkpoint is left
    # Too little time: what there is stays, and the same command goes on from it; another seed's does not.
    words = ["posterior", fits / "oren_nayar.json", "--out", tmp_path / "short.json", "--json"]
    ran = run(*words, "--budget-seconds", "1e-3")
    assert (ran.status, ran.document["status"]) == (0, "not_converged")
    assert "goes on from" in ran.err
    ran = run(*words, "--seed", "9")
    assert (ran.status, ran.document["error"]["code"]) == (2, "checkpoint-other-run")
    ran = run(*words)
    assert (ran.status, ran.document["cost"]["resumed_at_step"]) == (0, 50)
    assert not (tmp_path / "short.json.checkpoint").exists()

    folder = tmp_path / "report"
    ran = run(
        "report", fits / "ward.json", fits / "oren_nayar.json", "--posterior", out, "--out", folder, "--json",
        "--pdf",
    )
    assert ran.status == 0, ran.err
    assert ran.document["model"] == "oren_nayar"  # the posterior's, not the first
    assert sorted(path.name for path in folder.iterdir()) == ["report.html", "report.json", "report.pdf"]
    assert "<html" in (folder / "report.html").read_text()
    # The posterior of one model with the fit of another alone: refused.
    ran = run("report", fits / "ward.json", "--posterior", out, "--out", tmp_path / "no", "--json")
    assert (ran.status, ran.document["error"]["code"]) == (2, "which-fit")
    assert list((tmp_path / "no").iterdir()) == []


def test_calibrate(run: Run, fits: Path, tmp_path: Path) -> None:
    words = ["calibrate", fits / "oren_nayar.json", "--simulations", "1", "--rhat", "1.2"]
    words += ["--max-samples", "200", "--budget-seconds", "2"]
    ran = run(*words, "--range", "sigma=0.1,0.6", "--out", tmp_path, "--json")
    assert ran.status == 0, ran.err
    assert ran.document["ranges"]["sigma"] == pytest.approx([0.1, 0.6])
    assert (tmp_path / "calibration.png").exists()
    assert json.loads((tmp_path / "calibration.json").read_text()) == ran.document
    refused = run(*words, "--range", "albedo=0,1", "--json")
    assert refused.status == 2
    assert "albedo" in refused.err


def test_report_of_fits_of_different_tables(run: Run, fits: Path, tmp_path: Path) -> None:
    document: dict[str, Any] = json.loads((fits / "ward.json").read_bytes())
    document["table"]["hash"] = "0" * 64
    other = tmp_path / "other.json"
    other.write_text(json.dumps(document))
    ran = run("report", fits / "ward.json", other, "--out", tmp_path / "out", "--json")
    assert (ran.status, ran.document["error"]["code"]) == (2, "table-differs")


def test_one_fit_of_several(run: Run, fits: Path, tmp_path: Path) -> None:
    both = [json.loads((fits / name).read_bytes()) for name in ("ward.json", "oren_nayar.json")]
    several = tmp_path / "several.json"
    several.write_text(json.dumps({"kind": "brdf-fitter/fits", "fits": both, "failures": []}))
    words = ["sample", "--model", several, "--theta-i", "30", "-n", "5", "--seed", "1", "--json"]
    ran = run(*words)
    assert (ran.status, ran.document["error"]["code"]) == (2, "which-fit")
    from fitter.cli.results import load_result

    assert load_result(several, "oren_nayar").model.spec.name == "oren_nayar"


@pytest.mark.long
def test_serve_until_interrupted(tmp_path: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    running = process("serve", "--port", port, "--folder", tmp_path / "data", "--json")
    try:
        for _ in range(300):
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz", timeout=1) as answer:
                    assert answer.status == 200
                break
            except OSError:  # not there yet, or too busy to answer within a second
                assert running.poll() is None
                time.sleep(0.1)
    finally:
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=30)
    assert running.returncode == 0, err
    assert json.loads(out)["url"] == f"http://127.0.0.1:{port}"
    assert "Traceback" not in err


@pytest.mark.long
def test_demo(run: Run, tmp_path: Path) -> None:
    ran = run("demo", "--out", tmp_path / "demo", "--budget-seconds", "30", "--json")
    assert ran.status == 0, ran.err
    document = ran.document
    assert document["best"] == "torrance_sparrow"
    assert {model["status"] for model in document["models"].values()} == {"converged"}
    page = Path(document["html"])
    assert page == (tmp_path / "demo" / "report.html").resolve()
    assert page.read_text().lstrip().lower().startswith("<!doctype html>")
    assert document["seconds"]["total"] == pytest.approx(
        sum(seconds for step, seconds in document["seconds"].items() if step != "total"), abs=0.5
    )


def test_check(run: Run, plaster: Path) -> None:
    document = run("check", plaster, "--json").document
    assert document == fitter.check(fitter.load(plaster)).to_dict()
    assert document["kind"] == "brdf-fitter/check"
    text = run("check", plaster).out
    for finding in document["findings"]:
        assert finding["sentence"] in text
    assert "not judged" in text


def test_check_of_a_folder(run: Run, tmp_path: Path) -> None:
    run("datasets", "copy", "diffuse_plaster", "glossy_paint", "--out", tmp_path)
    document = run("check", tmp_path, "--json").document
    assert document["kind"] == "brdf-fitter/checks"
    assert [table["name"] for table in document["checks"]] == ["diffuse_plaster", "glossy_paint"]
    assert "glossy_paint" in run("check", tmp_path).out


def test_a_bad_table_is_a_result(run: Run, tmp_path: Path) -> None:
    table = tmp_path / "white.csv"
    rows = [f"{i},0,{o},{p},0.4" for i in (0, 45) for o in range(0, 90, 5) for p in range(0, 360, 20)]
    table.write_text("theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,brdf\n" + "\n".join(rows) + "\n")
    ran = run("check", table, "--json")
    assert ran.status == 0
    assert ran.document["verdict"] == "warning"
    assert run("check", table, "--seed", "-1").status == 2


def test_a_folder_of_programs_that_can_not_be_made_is_named(
    run: Run, plaster: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one that the environment names, not the one that would be taken otherwise."""
    (tmp_path / "file").touch()
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "file" / "programs"))
    ran = run("fit", plaster, "--model", "lambert")
    assert ran.status == 0
    assert f"{tmp_path / 'file' / 'programs'} can't be made (Not a directory)" in ran.err
