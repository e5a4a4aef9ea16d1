"""The benchmark runs, and the page shows the committed document."""

from __future__ import annotations

import json

from fitter.documents import read_document
from tests.bench.__main__ import main, measure
from tests.bench.machine import ROOT
from tests.bench.measuring import Size
from tests.bench.page import insert, lines

DOCS = ROOT / "docs"


def test_a_small_case_makes_a_document_and_a_table() -> None:
    document = measure(["compression"], Size(quick=True))
    assert json.loads(json.dumps(document)) == document
    assert document["rows"][0]["others"][0]["advantage"] > 1
    assert any("float32 + zstd" in line for line in lines(document))


def test_the_page_shows_the_committed_document(capsys) -> None:
    document = read_document(DOCS / "benchmarks.json", "not-a-bench")
    page = (DOCS / "benchmarks.md").read_text()
    assert insert(page, document) == page
    assert main(["--markdown", str(DOCS / "benchmarks.json")]) == 0
    assert capsys.readouterr().out.strip() in page
