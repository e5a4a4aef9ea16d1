"""A POST that names itself makes what it makes once."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from sqlalchemy.exc import OperationalError

from api import idempotency
from api.rows import IdempotencyRow, JobRow, ModelRow, TableRow

from .conftest import small_table

MODEL = {"model": "ward", "values": {"kd": 0.1, "ks": 0.05, "alpha": 0.2}}


def named(key: str, **more: str) -> dict[str, str]:
    return {"idempotency-key": key, **more}


def test_the_same_again_is_answered_and_not_done(client: Any, table: str, wait: Any) -> None:
    wanted = {"table": table, "model": "oren_nayar"}
    for path, sent in (
        ("/v1/fits", {"json": wanted}), ("/v1/models", {"json": MODEL}),
        ("/v1/tables?name=x", {"content": small_table()}),
    ):  # fmt: skip
        first = client.post(path, **sent, headers=named("a" + path))
        again = client.post(path, **sent, headers=named("a" + path))
        assert (again.status_code, again.content) == (first.status_code, first.content)
        assert again.headers["location"] == first.headers["location"]
        assert again.headers["content-type"] == first.headers["content-type"]
        assert "idempotency-replayed" not in first.headers
        assert again.headers["idempotency-replayed"] == "true"
        other = client.post(path, **sent, headers=named("b" + path))
        assert other.json()["id"] != first.json()["id"]
        if path == "/v1/fits":
            wait(client, first.headers["location"])
            wait(client, other.headers["location"])


def test_another_request_under_the_same_name_is_refused(client: Any) -> None:
    assert client.post("/v1/models", json=MODEL, headers=named("c")).status_code == 201
    for path, sent in (
        ("/v1/models", {"json": {**MODEL, "channels": ["R"]}}), ("/v1/models?x=1", {"json": MODEL}),
        ("/v1/tables", {"content": small_table()}),
    ):  # fmt: skip
        answer = client.post(path, **sent, headers=named("c"))
        assert (answer.status_code, answer.json()["code"]) == (422, "idempotency-key-reused")
    for bad in ("", "x" * 256):
        assert client.post("/v1/models", json=MODEL, headers=named(bad)).status_code == 422
    # Of one that came to nothing the name is free again.
    assert client.post("/v1/models", json={"model": "no"}, headers=named("d")).status_code == 422
    assert client.post("/v1/models", json=MODEL, headers=named("d")).status_code == 201


def framed(content: bytes) -> dict[str, Any]:
    head = b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.csv"\r\n\r\n'
    return {"content": head + content + b"\r\n--b--\r\n"}


def test_uploads_are_told_apart_by_their_bytes(client: Any) -> None:
    """Raw bytes are hashed on the way to the disk, a form's as they come."""
    for key, form, as_sent in (("raw", "text/plain", lambda table: {"content": table}),
                               ("form", "multipart/form-data; boundary=b", framed)):  # fmt: skip
        headers = named(f"upload-{key}", **{"content-type": form})
        first = client.post("/v1/tables", **as_sent(small_table(1)), headers=headers)
        assert first.status_code == 201, first.text
        again = client.post("/v1/tables", **as_sent(small_table(1)), headers=headers)
        assert (again.content, again.headers["idempotency-replayed"]) == (first.content, "true")
        other = client.post("/v1/tables", **as_sent(small_table(2)), headers=headers)
        assert (other.status_code, other.json()["code"]) == (422, "idempotency-key-reused")


def test_what_only_asks_needs_no_name(client: Any, model: str) -> None:
    pairs = {"wi": [0, 0, 1], "wo": [0, 0, 1]}
    for _ in range(2):
        answer = client.post(f"/v1/models/{model}/evaluate", json=pairs, headers=named("e"))
        assert "idempotency-replayed" not in answer.headers


def test_two_at_once(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    store = client.app.state.service.store
    entered, go = threading.Event(), threading.Event()
    plain = store.add

    def slow(row: Any) -> None:
        entered.set()
        assert go.wait(30)
        plain(row)

    monkeypatch.setattr(store, "add", slow)
    answers: list[Any] = []
    first = threading.Thread(
        target=lambda: answers.append(client.post("/v1/models", json=MODEL, headers=named("f")))
    )
    first.start()
    assert entered.wait(30)
    second = client.post("/v1/models", json=MODEL, headers=named("f"))
    assert (second.status_code, second.json()["code"]) == (409, "in-flight")
    assert second.headers["retry-after"]
    go.set()
    first.join()
    assert answers[0].status_code == 201


def test_a_claim_that_is_not_renewed_lapses(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    store = client.app.state.service.store
    with monkeypatch.context() as patched:
        patched.setattr(idempotency, "LEASE", -1.0)
        made = idempotency.claim(store, "", "i")
        assert isinstance(made, str)
        assert idempotency.claim(store, "", "i") == made  # and what it makes keeps its id
    idempotency.renew(store, "", "i")
    assert idempotency.claim(store, "", "i") is None
    assert client.post("/v1/models", json=MODEL, headers=named("i")).status_code == 409


def test_a_claim_is_renewed_while_its_request_is_worked_on(
    client: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = client.app.state.service.store
    renewed = threading.Event()
    monkeypatch.setattr(idempotency, "renew", lambda *_: renewed.set())
    monkeypatch.setattr(idempotency, "LEASE", 0.03)
    plain = store.add

    def slow(row: Any) -> None:
        assert renewed.wait(30)
        plain(row)

    monkeypatch.setattr(store, "add", slow)
    assert client.post("/v1/models", json=MODEL, headers=named("j")).status_code == 201


def test_a_database_that_goes_away_holds_a_request_up_no_longer_than_its_claim(
    client: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def away(*_: Any, **__: Any) -> None:
        raise OperationalError("INSERT", {}, Exception("gone"))

    with monkeypatch.context() as patched:
        patched.setattr(idempotency, "LEASE", 0.2)
        patched.setattr(client.app.state.service.store, "add", away)
        # The release goes the same way: what broke is told all the same.
        patched.setattr(idempotency, "release", away)
        answer = client.post("/v1/models", json=MODEL, headers=named("k"))
        assert (answer.status_code, answer.json()["code"]) == (503, "database-away")
    end = time.monotonic() + 20
    while (again := client.post("/v1/models", json=MODEL, headers=named("k"))).status_code == 409:
        assert time.monotonic() < end
        time.sleep(0.05)
    assert again.status_code == 201


@pytest.mark.parametrize(
    ("kind", "path", "sent"),
    [
        (ModelRow, "/v1/models", {"json": MODEL}), (TableRow, "/v1/tables", {"content": small_table()}),
        (JobRow, "/v1/fits", {"json": {"model": "oren_nayar"}}),
    ],
)  # fmt: skip
def test_a_server_that_dies_before_it_answers_has_done_it(
    serving: Callable[..., Any], kind: Any, path: str, sent: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    client = serving()
    if kind is JobRow:
        table = client.post("/v1/tables", content=small_table()).json()["id"]
        sent = {"json": {**sent["json"], "table": table}}
    with monkeypatch.context() as patched:
        # What is kept of a request whose server is killed after it made the row: the claim.
        patched.setattr(idempotency, "keep", lambda *_: None)
        first = client.post(path, **sent, headers=named("g"))
    assert client.post(path, **sent, headers=named("g")).status_code == 409
    client.__exit__(None, None, None)
    again = serving()
    second = again.post(path, **sent, headers=named("g"))
    assert second.status_code == first.status_code
    assert second.json()["id"] == first.json()["id"]
    assert again.app.state.service.store.page(kind, 10, 0)[1] == 1
    third = again.post(path, **sent, headers=named("g"))
    assert third.content == second.content


def test_answers_are_forgotten_after_a_day(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    first = client.post("/v1/models", json=MODEL, headers=named("h"))
    monkeypatch.setattr(idempotency, "KEPT", -1.0)
    assert client.post("/v1/models", json=MODEL, headers=named("h")).json()["id"] != first.json()["id"]
    with client.app.state.service.store.reading() as session:
        assert session.query(IdempotencyRow).count() == 1
