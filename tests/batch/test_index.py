"""The index in a browser: sorted, searched and filtered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fitter.batch import page

MOST = 6


def _record(k: int) -> dict[str, Any]:
    relative = 0.5 if k == 3 else 0.01 * k
    fit = {
        "model": "ward", "file": "ward.json", "status": "converged", "warnings": [],
        "metrics": {"rmse": 1.0 / (k + 1), "relative_rmse": relative},
    }  # fmt: skip
    table = {
        "table": f"t{k}", "folder": f"tables/t{k}", "fits": [fit], "best": "ward", "notes": [], "usable": 9,
        "seconds": 0.1,
    }  # fmt: skip
    return {"unit": {"name": f"t{k}"}, "error": None, "tables": [table]}


def test_the_bad_ones_are_found(tmp_path: Path) -> None:
    from tests.api.browser import opened

    index = page.Index(reports=False)
    for k in range(MOST):
        index.add(_record(k))
    index.add({"unit": {"name": "half"}, "error": {"message": "the file is too short"}, "tables": []})
    (tmp_path / "index.html").write_text(index.render())
    with opened() as browser:
        shown = browser.new_page()
        complaints: list[str] = []
        shown.on("pageerror", lambda error: complaints.append(str(error)))
        shown.goto((tmp_path / "index.html").as_uri())

        def names() -> list[str]:
            return shown.locator("tbody tr:visible td:first-child").all_inner_texts()

        assert names() == ["half", "t3", "t5", "t4", "t2", "t1", "t0"]
        shown.get_by_role("button", name="rms residual").click()
        assert names() == ["t5", "t4", "t3", "t2", "t1", "t0", "half"]
        shown.get_by_role("button", name="rms residual").click()
        assert names()[1:] == ["t0", "t1", "t2", "t3", "t4", "t5"]
        shown.get_by_label("Status").select_option("failed")
        assert names() == ["half"]
        shown.get_by_label("Status").select_option("")
        shown.get_by_label("Find").fill("too short")
        assert names() == ["half"]
        assert shown.get_by_role("status").inner_text() == f"1 of {MOST + 1} shown"
        assert not complaints
