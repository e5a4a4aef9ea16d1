"""The front page, the documentation, health, metrics and the errors of no route at all."""

from __future__ import annotations

import re
from typing import Any

import httpx
import pytest
from sqlalchemy.exc import OperationalError

from .conftest import listening


def test_pages_fetch_nothing_from_outside(client: Any) -> None:
    front, docs = client.get("/"), client.get("/docs")
    assert 'href="docs"' in front.text
    for page in (front, docs):
        assert not re.findall(r'(?:src|href)="(?:https?:)?//[^"]*"', page.text)
    for asset in re.findall(r'(?:src|href)="(docs-assets/[^"]*)"', docs.text):
        assert client.get(f"/{asset}").status_code == 200
    assert client.get("/openapi.json").json()["openapi"].startswith("3.1")


def test_host_header_is_not_markup(client: Any) -> None:
    page = client.get("/", headers={"host": 'x"><script>alert(1)</script>'})
    assert "<script>" not in page.text


def test_health(client: Any) -> None:
    assert client.get("/healthz").json()["status"] == "ok"
    assert client.get("/readyz").json()["status"] == "ok"


def test_readiness_says_no(serving: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    client = serving()
    service = client.app.state.service

    def away() -> None:
        raise OperationalError("select 1", {}, Exception("gone"))

    with monkeypatch.context() as patched:
        patched.setattr(service.store, "ping", away)
        assert client.get("/readyz").status_code == 503
        assert client.get("/healthz").status_code == 200
    service.stopping.set()
    assert client.get("/readyz").json()["code"] == "not-ready"


def test_metrics(client: Any, table: str) -> None:
    answer = client.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    for line in answer.text.splitlines():
        assert re.fullmatch(r'#.*|[a-z_]+(\{([a-z]+="[^"]*",?)+\})? ([-+0-9.e]+|\+Inf)', line), line
    assert re.search(r"^brdf_tables [1-9]", answer.text, re.MULTILINE)


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nothing", 404), ("PUT", "/v1/tables", 405), ("DELETE", "/healthz", 405),
        ("GET", "/docs-assets/x", 404),
    ],
)  # fmt: skip
def test_errors_without_a_route(client: Any, method: str, path: str, status: int) -> None:
    answer = client.request(method, path)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["status"] == status
    assert ("allow" in answer.headers) == (status == 405)


def test_405_names_all_that_may_be_done(client: Any, table: str) -> None:
    for path, methods in (
        ("/v1/tables", "GET, POST, HEAD"),
        (f"/v1/tables/{table}", "GET, DELETE, HEAD"),
        ("/v1/jobs/none/cancel", "POST"),
        ("/docs-assets/swagger-ui.css", "GET, HEAD"),
    ):
        assert client.put(path).headers["allow"] == methods


def test_heads_are_those_of_get(client: Any, address: str, table: str, model: str) -> None:
    once = ("x-request-id", "server-timing", "date")

    def shown(answer: httpx.Response) -> dict[str, str]:
        return {name: text for name, text in answer.headers.items() if name not in once}

    with httpx.Client(base_url=address, timeout=30) as real:
        for path in (
            "/", "/healthz", "/readyz", "/v1/tables", f"/v1/tables/{table}", f"/v1/models/{model}",
            f"/v1/tables/{table}/content", "/v1/tables/none", "/nothing",
        ):  # fmt: skip
            whole, head = real.get(path), real.head(path)
            assert (head.status_code, head.content) == (whole.status_code, b""), path
            assert shown(head) == shown(whole), path
        tag = real.head(f"/v1/tables/{table}/content").headers["etag"]
        assert real.head(f"/v1/tables/{table}/content", headers={"if-none-match": tag}).status_code == 304
        assert real.head("/v1/jobs/none/cancel").status_code == 405
        ranged = real.head(f"/v1/tables/{table}/content", headers={"range": "bytes=0-9"})
        assert (ranged.status_code, int(ranged.headers["content-length"]) > 10) == (200, True)
    text = client.get("/metrics").text
    assert 'brdf_http_requests_total{method="HEAD",route="/v1/tables/{id}",status="200"}' in text


def test_the_head_of_a_stream_does_not_wait_for_its_end(serving: Any, table_bytes: bytes) -> None:
    client = serving(workers=0)
    table = client.post("/v1/tables", content=table_bytes).json()["id"]
    here = client.post("/v1/fits", json={"table": table, "model": "ward"}).headers["location"]
    with listening(client.app) as url:
        head = httpx.head(f"{url}{here}/events", timeout=20)
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["content-type"].startswith("text/event-stream")


def test_bodies_of_another_type(client: Any, table: str, model: str) -> None:
    """As `curl -d` sends them, for one: not JSON, whatever they hold."""
    wanted = b'{"table": "x", "model": "ward"}'
    pairs = b'{"wi": [0, 0, 1], "wo": [0, 0, 1]}'
    for path, body in (
        ("/v1/fits", wanted),
        (f"/v1/models/{model}/evaluate", pairs),
        (f"/v1/tables/{table}/evaluate", pairs),
    ):
        for kind in ("application/x-www-form-urlencoded", "text/plain; charset=utf-8", "text/x+json"):
            answer = client.post(path, content=body, headers={"content-type": kind})
            assert (answer.status_code, answer.json()["code"]) == (415, "unsupported-media-type"), (
                path,
                kind,
            )
            assert answer.headers["content-type"] == "application/problem+json"
            assert "application/json" in answer.json()["remedy"]
        assert (
            client.post(path, content=body, headers={"content-type": "application/x+json"}).status_code != 415
        )
    assert client.post("/v1/fits").status_code == 422
