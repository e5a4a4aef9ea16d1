"""Bad input: one clear message, status 2, a JSON problem where asked for, and nothing written."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest

from tests.cli.conftest import Run

HTML = b"<!DOCTYPE html><html><body>Please log in</body></html>"
ROWS = b"theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,brdf\n"
#: Name -> what the file holds.
FILES = {
    "empty": b"",
    "blank": b"\n \n",
    "html": HTML,
    "junk": bytes(range(256)) * 40,
    "header_only": ROWS,
    "not_a_number": ROWS + b"10,0,20,180,0.1\n10,0,30,180,abc\n",
    "all_nan": ROWS + b"10,0,20,180,nan\n10,0,30,180,nan\n",
    "huge_claim": struct.pack("<3i", 90, 2**30, 180) + b"\0" * 64,
    "png": b"\x89PNG\r\n\x1a\n" + b"\0" * 100,
    "half_container": b"\x89BRDFfit\x01\x00",
}  # fmt: skip
VERBS = {
    "info": (),
    "check": (),
    "fit": ("--model", "ward"),
    "compress": ("--tolerance", "0.01", "--out", "{out}/small"),
    "sample": ("--theta-i", "30", "-n", "10", "--seed", "1"),
}


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("kind", [*FILES, "missing", "folder"])
def test_no_table(run: Run, tmp_path: Path, verb: str, kind: str) -> None:
    path, out = tmp_path / kind, tmp_path / "out"
    if kind in FILES:
        path.write_bytes(FILES[kind])
    elif kind == "folder":
        path.mkdir()
    words = [word.format(out=out) for word in VERBS[verb]]
    ran = run(verb, path, *words)
    assert ran.status == 2, ran.err
    assert ran.out == ""
    assert "Traceback" not in ran.err
    assert kind in ran.err  # the file is named
    ran = run(verb, path, *words, "--json")
    error = ran.document["error"]
    assert ran.status == 2
    assert error["code"]
    assert error["message"]
    assert not out.exists() or not list(out.iterdir())


def test_the_message_names_row_and_column(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(FILES["not_a_number"])
    error = run("info", path, "--json").document["error"]
    assert error["file"] == "table.csv"
    assert error["row"] == 3
    assert error["column"] == "brdf"
    assert error["remedy"]


@pytest.mark.parametrize(
    ("words", "code", "parameter"),
    [
        (["--model", "gloss"], "unknown-model", "model"),
        (["--model", "ward:shiny"], "unknown-model", "model"),
        (["--model", "ward", "--model", "ward:ward1992"], "bad-call", "model"),
        (["--model", "ward", "--fixed", "roughness=0.1"], "unknown-parameter", "roughness"),
        (["--model", "ward", "--fixed", "kd=0.1"], "unknown-parameter", "kd"),
        (["--bounds", "nonsense=0,1"], "unknown-parameter", "nonsense"),
        (["--model", "ward", "--starts", "0"], "bad-spec", "starts"),
        (["--model", "ward", "--subset", "1"], "bad-spec", "subset"),
        (["--model", "ward", "--seed", "-1"], "bad-spec", "seed"),
        (["--model", "ward", "--theta-i-max", "120"], "bad-spec", "select.theta_i_max_deg"),
        (["--model", "ward", "--compress", "2"], "bad-tolerance", "tolerance"),
        (["--model", "ward", "--item", "7"], "unknown-item", "item"),
    ],
)
def test_no_fit(run: Run, plaster: Path, words: list[str], code: str, parameter: str) -> None:
    ran = run("fit", plaster, *words, "--json")
    assert ran.status == 2
    error = ran.document["error"]
    assert (error["code"], error["parameter"]) == (code, parameter)


@pytest.mark.parametrize(
    "words",
    [
        ["--bounds", "alpha=0.5,0.1"],
        ["--bounds", "alpha=-3,0.1"],
        ["--bounds", "alpha=nan,0.1"],
        ["--fixed", "alpha=9"],
        ["--fixed", "alpha=nan"],
        ["--channels", "X"],
        ["--theta-i-max", "0.001"],
    ],
)
def test_no_sensible_fit(run: Run, plaster: Path, words: list[str]) -> None:
    ran = run("fit", plaster, "--model", "ward", *words, "--json")
    assert ran.status in (1, 2)
    assert "error" in ran.document
    assert "Traceback" not in ran.err


@pytest.mark.parametrize("verb", ["fit", "compress", "sample", "datasets", "demo"])
def test_nowhere_to_write(run: Run, plaster: Path, tmp_path: Path, verb: str) -> None:
    (tmp_path / "file").write_text("in the way")
    words = {
        "fit": ["fit", plaster, "--model", "ward", "--out"],
        "compress": ["compress", plaster, "--tolerance", "0.01", "--out"],
        "sample": ["sample", plaster, "--theta-i", "30", "-n", "5", "--seed", "1", "--out"],
        "datasets": ["datasets", "copy", "diffuse_plaster", "--out"],
        "demo": ["demo", "--out"],
    }[verb]
    ran = run(*words, tmp_path / "file" / "deeper.npz", "--json")
    assert ran.status == 2
    assert ran.document["error"]["code"] == "out-not-writable"


@pytest.mark.parametrize(
    "content", [b"", b"nonsense", b"[]", b"{}", b'{"kind": "brdf-fitter/fit"}', b"\xff\xfe"]
)
@pytest.mark.parametrize("verb", ["posterior", "report", "sample"])
def test_no_result(run: Run, tmp_path: Path, verb: str, content: bytes) -> None:
    path = tmp_path / "result.json"
    path.write_bytes(content)
    words = {
        "posterior": ["posterior", path],
        "report": ["report", path, "--out", tmp_path / "out"],
        "sample": ["sample", "--model", path, "--theta-i", "30", "-n", "5", "--seed", "1"],
    }[verb]
    ran = run(*words, "--json")
    assert ran.status == 2, ran.err
    error = ran.document["error"]
    assert error["code"] == "not-a-fit"
    assert error["file"] == str(path)


@pytest.mark.parametrize(
    "words",
    [
        ["--theta-i", "90"],
        ["--theta-i", "nan"],
        ["--theta-i", "-1"],
        ["--theta-i", "30", "--phi-i", "1000"],
        ["--theta-i", "30", "-n", "0"],
        ["--theta-i", "30", "--seed", "-1"],
        ["--theta-i", "30", "--out", "draws.txt"],
        ["--theta-i", "30", "--model", "also.json"],
        ["--theta-i", "89.9"],
    ],
)
def test_no_draws(
    run: Run, plaster: Path, words: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = run("sample", plaster, "-n", "5", "--seed", "1", *words, "--json")
    assert ran.status == 2, ran.err
    assert "error" in ran.document
    assert list(tmp_path.iterdir()) == []


def test_the_table_of_a_result_has_changed(run: Run, fits: Path, tmp_path: Path) -> None:
    from fitter import datasets

    result = fits / "oren_nayar.json"
    ran = run("posterior", result, "--table", datasets.sample("glossy_paint"), "--json")
    assert (ran.status, ran.document["error"]["code"]) == (2, "table-differs")
    document = json.loads(result.read_bytes())
    document["table"]["source"]["path"] = str(tmp_path / "gone.csv")
    moved = tmp_path / "moved.json"
    moved.write_text(json.dumps(document))
    ran = run("posterior", moved, "--json")
    assert (ran.status, ran.document["error"]["code"]) == (2, "table-missing")
    assert "gone.csv" in ran.err


def test_datasets_that_do_not_exist(run: Run, tmp_path: Path) -> None:
    assert (
        run("datasets", "copy", "nonsense", "--out", tmp_path, "--json").document["error"]["code"]
        == "unknown-dataset"
    )
    assert run("datasets", "copy", "--out", tmp_path).status == 2
    assert run("datasets", "list", "nonsense").status == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["--port", "0"], "bad-call"),
        (["--port", "70000"], "bad-call"),
        (["--workers", "0"], "bad-call"),
        (["--host", "203.0.113.1"], "address-unusable"),
        (["--folder", "/dev/null/data"], "out-not-writable"),
    ],
)
def test_no_service(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], code: str
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = run("serve", *words, "--json")
    assert (ran.status, ran.document["error"]["code"]) == (2, code)
