"""Views of tables and fits over HTTP: the same numbers as in Python."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from api.tables import parse
from fitter.views import Views, lobe


@pytest.fixture(scope="module")
def parsed(table_bytes: bytes) -> Any:
    return parse(table_bytes, {}, "0" * 64)


def test_lobe(client: Any, table: str, parsed: Any) -> None:
    found = client.get(f"/v1/tables/{table}/lobe?theta_i_deg=40&step_deg=10").json()
    expected = lobe(parsed, 40.0, step_deg=10.0)
    assert found["channels"] == ["R", "G", "B"]
    assert found["turn_deg"] == expected.turn_deg.tolist()
    assert np.allclose(found["values"], expected.values, rtol=1e-6)
    assert found["extrapolated"] == expected.extrapolated.tolist()
    for query in ("", "theta_i_deg=90", "theta_i_deg=40&step_deg=0.5", "theta_i_deg=nan"):
        assert client.get(f"/v1/tables/{table}/lobe?{query}").status_code == 422


def test_views_of_the_whole_table(client: Any, table: str, parsed: Any) -> None:
    views = Views(parsed)
    image = client.get(f"/v1/tables/{table}/half-difference").json()
    values = np.array(image["values"], dtype=float)
    assert np.allclose(values, views.half_difference().values, rtol=1e-6, equal_nan=True)
    covered = client.get(f"/v1/tables/{table}/coverage").json()
    assert covered["usable"] == views.coverage().usable.tolist()
    assert covered["samples"] == len(parsed)
    cuts = client.get(f"/v1/tables/{table}/cuts").json()
    assert [cut["theta_i_deg"] for cut in cuts["cuts"]] == pytest.approx([0, 20, 40, 60], abs=1e-6)
    for mine, theirs in zip(cuts["cuts"], views.cuts().cuts, strict=True):
        assert mine["values"] == theirs.channels.tolist()
    for view in ("lobe?theta_i_deg=1", "half-difference", "coverage", "cuts"):
        assert client.get(f"/v1/tables/{'0' * 32}/{view}").status_code == 404


def test_a_fit_beside_its_data(client: Any, fit: str) -> None:
    report = client.get(f"/v1/fits/{fit}/report.json").json()
    assert client.get(f"/v1/fits/{fit}/residuals").json() == report["residuals"]
    slices = client.get(f"/v1/fits/{fit}/slices").json()
    assert slices["predictive_level"] is None
    for mine, theirs in zip(slices["slices"], report["slices"]["slices"], strict=True):
        assert mine["points"] == theirs["points"]
        assert mine["curve"]["fit"] == theirs["curve"]["fit"]


def test_of_a_deleted_table(client: Any, table_bytes: bytes, wait: Any) -> None:
    table = client.post("/v1/tables", content=table_bytes).json()["id"]
    started = client.post("/v1/fits", json={"table": table, "model": "oren_nayar"})
    job = wait(client, started.headers["location"])
    fit = job["results"][0]["id"]
    for kind, made in (("fits", fit), ("jobs", job["id"])):
        assert [one["id"] for one in client.get(f"/v1/{kind}?table={table}").json()["items"]] == [made]
    assert client.delete(f"/v1/tables/{table}").status_code == 204
    for view in ("residuals", "slices"):
        answer = client.get(f"/v1/fits/{fit}/{view}")
        assert (answer.status_code, answer.json()["code"]) == (409, "table-gone")
