"""The benchmark runs, and the page shows the committed document."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fitter.documents import read_document
from tests.bench.__main__ import main, measure, merged
from tests.bench.machine import ROOT
from tests.bench.measuring import Size
from tests.bench.page import insert, lines

DOCS = ROOT / "docs"


def test_a_small_case_makes_a_document_and_a_table() -> None:
    document = measure(["compression"], Size(quick=True))
    assert json.loads(json.dumps(document)) == document
    assert document["runs"][0]["rows"][0]["others"][0]["advantage"] > 1
    assert any("float32 + zstd" in line for line in lines(document))


def test_groups_that_are_not_measured_again_stay() -> None:
    def document(commit: str, *rows: tuple[str, str]) -> dict[str, Any]:
        run = {"commit": commit, "rows": [{"group": group, "case": case} for group, case in rows]}
        return {"kind": "brdf-fitter/bench", "version": 2, "runs": [run]}

    first = document("a", ("fit", "old"), ("fit", "older"), ("service", "kept"))
    second = merged(first, document("b", ("fit", "new")))
    assert second["runs"] == [
        {"commit": "a", "rows": [{"group": "service", "case": "kept"}]},
        {"commit": "b", "rows": [{"group": "fit", "case": "new"}]},
    ]
    third = merged(second, document("c", ("service", "new"), ("page", "new")))
    assert [run["commit"] for run in third["runs"]] == ["b", "c"]


def test_another_file_is_not_written_over(tmp_path: Path, capsys) -> None:
    other = tmp_path / "other.json"
    other.write_text('{"kind": "brdf-fitter/fit"}')
    with pytest.raises(SystemExit) as ended:
        main(["--quick", "--only", "compression", "--out", str(other)])
    assert ended.value.code == 2
    assert "name another file" in capsys.readouterr().err
    assert other.read_text() == '{"kind": "brdf-fitter/fit"}'


def test_the_page_shows_the_committed_document(capsys) -> None:
    document = read_document(DOCS / "benchmarks.json", "not-a-bench")
    page = (DOCS / "benchmarks.md").read_text()
    assert insert(page, document) == page
    assert main(["--markdown", str(DOCS / "benchmarks.json")]) == 0
    assert capsys.readouterr().out.strip() in page
