"""Request ids, metrics and the log."""

from __future__ import annotations

import io
import json
import logging
import time
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from api import logs


def values(client: Any) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    families = text_string_to_metric_families(client.get("/metrics").text)
    return {(s.name, frozenset(s.labels.items())): s.value for family in families for s in family.samples}


def test_ids_come_and_go(client: Any) -> None:
    assert client.get("/v1/tables", headers={"x-request-id": "mine-1"}).headers["x-request-id"] == "mine-1"
    made = [client.get("/v1/tables/x").headers["x-request-id"] for _ in range(2)]
    assert made[0] != made[1]
    for bad in ("x" * 65, "a b", "a\tb", "<a>", ""):
        found = client.get("/healthz", headers={"x-request-id": bad}).headers["x-request-id"]
        assert found != bad
        assert len(found) == 32


def test_what_the_server_took_is_told_apart_from_the_sending(address: str, model: str) -> None:
    body = b'{"wi": [0, 0, 1], "wo": [0, 0, 1]}'

    def slowly() -> Iterator[bytes]:
        yield body[:9]
        time.sleep(0.3)
        yield body[9:]

    answer = httpx.post(f"{address}/v1/models/{model}/evaluate", content=slowly())
    assert answer.status_code == 200
    parts = dict(part.strip().split(";dur=") for part in answer.headers["server-timing"].split(","))
    assert float(parts["receive"]) >= 250
    assert float(parts["app"]) > 0


def test_what_is_done_is_counted(client: Any, table_bytes: bytes, table: str, fit: str, model: str) -> None:
    before = values(client)
    client.post("/v1/tables", content=table_bytes)
    client.get("/v1/tables/nothing")
    client.request("BREW", "/v1/tables")
    draws = {"wi": [0, 0, 1], "n": 5, "seed": 1}
    client.post(f"/v1/models/{model}/sample", json=draws)
    client.post(f"/v1/tables/{table}/samples", json=draws)
    after = values(client)

    def grew(name: str, **labels: str) -> float:
        key = name, frozenset(labels.items())
        return after.get(key, 0.0) - before.get(key, 0.0)

    assert grew("brdf_upload_bytes_total") == len(table_bytes)
    assert grew("brdf_problems_total", code="not-found") == 1
    assert grew("brdf_http_requests_total", method="POST", route="/v1/tables", status="201") == 1
    assert grew("brdf_http_requests_total", method="GET", route="/v1/tables/{id}", status="404") == 1
    assert grew("brdf_http_request_seconds_count", route="/v1/tables/{id}") == 1
    for sampler in ("model", "table"):
        assert grew("brdf_acceptance_count", sampler=sampler) == 1
    assert {dict(labels).get("method") for name, labels in after if "requests" in name} <= {
        None, "GET", "HEAD", "POST", "DELETE", "other",
    }  # fmt: skip
    # Of the shared fit job, which ended before: one model converged, one could not be fitted.
    failed = frozenset({"kind": "fit", "model": "ward", "status": "failed"}.items())
    assert after["brdf_results_total", failed]
    converged = frozenset({"kind": "fit", "model": "oren_nayar", "status": "converged"}.items())
    assert after["brdf_results_total", converged]
    assert after["brdf_result_seconds_sum", frozenset({"kind": "fit", "model": "oren_nayar"}.items())] > 0
    assert after["brdf_job_seconds_count", frozenset({("kind", "fit")})]
    assert after["brdf_jobs", frozenset({("state", "done")})]


@pytest.fixture
def lines() -> Iterator[io.StringIO]:
    """What the service's loggers write while a test runs."""
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(logs.JsonLines())
    logger = logging.getLogger("brdf_fitter")
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    yield stream
    logger.removeHandler(handler)
    logger.setLevel(before)


def test_the_log_is_json_and_names_request_and_job(
    client: Any, table: str, wait: Any, lines: io.StringIO
) -> None:
    wanted = {"table": table, "model": "oren_nayar"}
    started = client.post("/v1/fits", json=wanted, headers={"x-request-id": "r1"})
    wait(client, started.headers["location"])
    client.get("/v1/%22%0A%E2%80%A8/x", headers={"x-request-id": "r2"})
    found = [json.loads(line) for line in lines.getvalue().split("\n") if line]
    (answered,) = [one for one in found if one.get("request") == "r1"]
    id = started.json()["id"]
    assert (answered["status"], answered["method"], answered["path"]) == (202, "POST", "/v1/fits")
    assert (answered["job"], answered["level"], answered["logger"]) == (id, "info", "brdf_fitter.access")
    assert answered["time"].endswith("Z")
    (ended,) = [one for one in found if one["message"] == "a job has ended" and one["job"] == id]
    assert (ended["state"], ended["kind"], ended["attempt"]) == ("done", "fit", 1)
    assert [one["status"] for one in found if one.get("request") == "r2"] == [404]


def test_an_unforeseen_error_is_logged_under_its_request(
    client: Any, lines: io.StringIO, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("secret")

    monkeypatch.setattr(client.app.state.service.store, "page", broken)
    answer = client.get("/v1/tables", headers={"x-request-id": "r3"})
    assert (answer.status_code, answer.json()["code"]) == (500, "internal-error")
    assert (answer.json()["request"], answer.headers["x-request-id"]) == ("r3", "r3")
    assert "secret" not in answer.text
    failed = [json.loads(line) for line in lines.getvalue().splitlines()]
    assert [one["level"] for one in failed if one["request"] == "r3"] == ["error", "info"]
    assert "RuntimeError: secret" in failed[0]["traceback"]
