"""Tradeoffs: asked for, listed, read, drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from fitter.tradeoffs import Tradeoff

#: No axis at all: the usual fit and its reference.
BARE = {
    "metrics": [], "solvers": [], "subsets": [], "starts": [], "tolerances": [], "posterior": False,
    "repeats": 1,
}  # fmt: skip


@pytest.mark.long
def test_a_tradeoff_is_a_job_whose_result_is_read_and_drawn(
    client: Any, table: str, wait: Callable[..., dict[str, Any]]
) -> None:
    asked = {"table": table, "models": ["oren_nayar"], "time_limit_seconds": 60, **BARE}
    answer = client.post("/v1/tradeoffs", json=asked)
    assert answer.status_code == 202, answer.text
    job = wait(client, answer.headers["location"])
    assert job["state"] == "done", job
    (result,) = job["results"]
    assert (result["kind"], result["models"]) == ("tradeoff", ["oren_nayar"])
    document = client.get(result["links"]["self"]).json()
    assert [p["axis"] for p in document["points"]][:2] == ["default", "reference"]
    assert Tradeoff.from_dict(document).table["fitted"] > 0
    assert document["links"]["job"] == f"/v1/jobs/{job['id']}"
    page = client.get(result["links"]["report"])
    assert page.headers["content-type"].startswith("text/html")
    assert "oren_nayar: reference" in page.text
    picture = client.get(result["links"]["picture"])
    assert picture.headers["content-type"] == "image/png"
    assert picture.content.startswith(b"\x89PNG")
    listed = {one["id"]: one for one in client.get("/v1/tradeoffs").json()["items"]}
    summary = listed[result["id"]]
    assert summary["models"] == ["oren_nayar"]


@pytest.mark.parametrize(
    "body",
    [
        {}, {"models": []}, {"models": ["glass"]}, {"models": ["he_torrance"]},
        {"models": ["ward"], "repeats": 0},
        {"models": ["ward"], "time_limit_seconds": 1e6}, {"models": ["ward"], "subsets": [1]},
    ],
)  # fmt: skip
def test_bad_requests(client: Any, table: str, body: dict[str, Any]) -> None:
    answer = client.post("/v1/tradeoffs", json={"table": table, **body})
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"


def test_unknown_ids(client: Any) -> None:
    assert client.post("/v1/tradeoffs", json={"table": "0" * 32, "models": ["ward"]}).status_code == 404
    for part in ("", "/report.html", "/picture.png"):
        assert client.get(f"/v1/tradeoffs/{'0' * 32}{part}").status_code == 404


def test_a_budget_that_cannot_be_kept_is_a_failed_job(
    client: Any, table: str, wait: Callable[..., dict[str, Any]]
) -> None:
    answer = client.post("/v1/fits", json={"table": table, "model": "oren_nayar", "target_error": 1e-15})
    job = wait(client, answer.headers["location"])
    assert job["state"] == "failed"
    assert job["problem"]["code"] == "unattainable"
    assert job["problem"]["parameter"] == "target_error"
