"""Keys: who may ask for what, and that nobody learns of another's things."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from api import keys
from api.client import Client, Refused
from api.rates import Rates
from api.sessions import Sessions
from fitter.cli import main
from fitter.errors import SpecError

from .conftest import listening, small_table
from .test_scenes import small


class Guarded:
    """A service that asks for keys, and a client of each owner and scope."""

    def __init__(self, client: Any, url: str) -> None:
        self.client = client
        self.store: Sessions = client.app.state.service.store
        self.url = url
        self.secrets = {
            (owner, scope): keys.create(self.store, owner, scope)[1]
            for owner, scope in (("ann", "write"), ("ann", "read"), ("bob", "write"), ("root", "admin"))
        }

    def as_(self, owner: str, scope: Any = "write") -> Client:
        return Client(self.url, key=self.secrets[owner, scope])

    def headers(self, owner: str, scope: Any = "write") -> dict[str, str]:
        return {"authorization": f"Bearer {self.secrets[owner, scope]}"}


@pytest.fixture(scope="module")
def guarded(serving_once: Callable[..., Any]) -> Iterator[Guarded]:
    client = serving_once(keys=True)
    with listening(client.app) as url:
        yield Guarded(client, url)


@pytest.fixture(scope="module")
def anns(guarded: Guarded) -> dict[str, str]:
    """One of each thing, all Ann's."""
    with guarded.as_("ann") as client:
        table = client.upload(small_table(), name="anns")
        fit = client.wait(client.start("fits", table=table.id, model="oren_nayar"))
        id = fit.results[0]["id"]
        found = {"tables": table.id, "jobs": fit.id, "fits": id, "models": id}
        short = {"budget_seconds": 2, "ess": 50, "max_samples": 50}
        job = client.wait(client.start("posteriors", fit=found["fits"], **short))
        return {**found, "posteriors": job.results[0]["id"]}


def test_no_key_no_answer(guarded: Guarded) -> None:
    client = guarded.client
    for path in ("/v1/tables", "/v1/nothing", "/metrics", "/v1/model-families"):
        answer = client.get(path)
        assert (answer.status_code, answer.headers["www-authenticate"]) == (401, "Bearer")
        assert answer.headers["content-type"] == "application/problem+json"
    for wrong in ("Bearer brdf_x", "Basic eDp5", "Bearer ", guarded.secrets["ann", "write"]):
        assert client.get("/v1/tables", headers={"authorization": wrong}).status_code == 401
    for path in ("/healthz", "/readyz", "/", "/docs", "/openapi.json"):
        assert client.get(path).status_code == 200
    # Refused before a byte of the body is there.
    where = urlsplit(guarded.url)
    with socket.create_connection((where.hostname, where.port or 80)) as wire:
        wire.sendall(b"POST /v1/tables HTTP/1.1\r\nHost: x\r\nContent-Length: 100000000\r\n\r\n")
        assert b" 401 " in wire.recv(4096)


@pytest.mark.long
def test_scopes(guarded: Guarded, anns: dict[str, str]) -> None:
    client, reader = guarded.client, guarded.headers("ann", "read")
    pairs = {"wi": [0, 0, 1], "wo": [0, 0, 1]}
    draws = {"wi": [0, 0, 1], "n": 2, "seed": 1}
    for path, sent in (
        (f"/v1/models/{anns['models']}/evaluate", pairs), (f"/v1/tables/{anns['tables']}/evaluate", pairs),
        (f"/v1/models/{anns['models']}/sample", draws), (f"/v1/tables/{anns['tables']}/samples", draws),
        (f"/v1/models/{anns['models']}/albedo", {"wi": [0, 0, 1]}),
        (f"/v1/models/{anns['models']}/pdf", pairs), ("/v1/scenes/plan", {"scene": small()}),
    ):  # fmt: skip
        assert client.post(path, json=sent, headers=reader).status_code == 200
    wanted = {"table": anns["tables"], "model": "oren_nayar"}
    for method, path, sent in (
        ("POST", "/v1/fits", wanted), ("DELETE", f"/v1/tables/{anns['tables']}", None),
        ("POST", f"/v1/jobs/{anns['jobs']}/cancel", None), ("POST", "/v1/models", {}),
        ("POST", "/v1/tables", None),
    ):  # fmt: skip
        answer = client.request(method, path, json=sent, headers=reader)
        assert (answer.status_code, answer.json()["code"]) == (403, "scope-missing")
        assert 'scope="write"' in answer.headers["www-authenticate"]
    assert client.get("/metrics", headers=guarded.headers("ann")).status_code == 403
    assert client.get("/metrics", headers=guarded.headers("root", "admin")).status_code == 200


def test_another_owner_s_things_are_not_there(guarded: Guarded, anns: dict[str, str]) -> None:
    """Bob gets the same answers for Ann's ids as for ids that nobody has."""
    client, bob = guarded.client, guarded.headers("bob")
    nobody = "0" * 32
    document = client.app.openapi()
    tried = 0
    for path, operations in document["paths"].items():
        noun = (path.split("/") + [""] * 3)[2]
        if "{id}" not in path or noun not in anns:
            continue
        for method in operations:
            example = (
                operations[method].get("requestBody", {}).get("content", {}).get("application/json", {})
            )
            sent = example.get("example")
            if sent is None and "$ref" in example.get("schema", {}):
                name = example["schema"]["$ref"].rpartition("/")[2]
                sent = document["components"]["schemas"][name]["example"]
            given = operations[method]["parameters"]
            query = {p["name"]: p["example"] for p in given if p["in"] == "query" and "example" in p}
            rest = {p["name"]: p["example"] for p in given if p["in"] == "path" and p["name"] != "id"}
            answers = [
                client.request(method, path.format(id=id, **rest), params=query, json=sent, headers=bob)
                for id in (anns[noun], nobody)
            ]
            assert [answer.status_code for answer in answers] == [404, 404], (method, path)
            there, not_there = (answer.text.replace(anns[noun], "").replace(nobody, "") for answer in answers)
            assert there == not_there
            tried += 1
    assert tried > 20
    for path, wanted in (
        ("/v1/fits", {"table": anns["tables"], "model": "ward"}), ("/v1/posteriors", {"fit": anns["fits"]}),
        ("/v1/calibrations", {"fit": anns["fits"]}),
        ("/v1/tradeoffs", {"table": anns["tables"], "models": ["ward"]}),
    ):  # fmt: skip
        assert client.post(path, json=wanted, headers=bob).status_code == 404
    for path in ("tables", "jobs", "fits", "models", "posteriors", "calibrations", "tradeoffs", "scenes"):
        assert client.get(f"/v1/{path}", headers=bob).json()["total"] == 0
        seen = client.get(f"/v1/{path}", headers=guarded.headers("ann", "read")).json()
        assert (seen["total"] > 0) == (path in anns), path
    everything = client.get("/v1/tables", headers=guarded.headers("root", "admin")).json()["items"]
    assert anns["tables"] in [one["id"] for one in everything]


def test_the_same_bytes_of_two_owners(guarded: Guarded) -> None:
    """Neither learns of the other's copy, whoever deletes first; request names are each one's own."""
    client, body = guarded.client, small_table(7)
    named = {"idempotency-key": "same"}
    answers = [
        client.post("/v1/tables?name=x", content=body, headers={**guarded.headers(owner), **named})
        for owner in ("ann", "bob")
    ]
    assert [answer.status_code for answer in answers] == [201, 201]
    first, second = (answer.json() for answer in answers)
    assert "idempotency-replayed" not in answers[1].headers
    assert first["id"] != second["id"]
    for one in (first, second):
        for differs in ("id", "created", "links"):
            one.pop(differs)
    assert first == second
    mine = answers[0].headers["location"], answers[1].headers["location"]
    assert client.delete(mine[0], headers=guarded.headers("ann")).status_code == 204
    assert client.get(f"{mine[1]}/check", headers=guarded.headers("bob")).status_code == 200
    assert client.delete(mine[1], headers=guarded.headers("bob")).status_code == 204


def test_a_revoked_key_is_good_no_longer(guarded: Guarded) -> None:
    row, secret = keys.create(guarded.store, "eve", "read", "laptop")
    with Client(guarded.url, key=secret) as client:
        assert list(client.tables()) == []
        keys.revoke(guarded.store, row.id)
        with pytest.raises(Refused) as refused:
            list(client.tables())
        assert (refused.value.status, refused.value.code) == (401, "key-needed")
    with guarded.store.reading() as session:
        kept = session.connection().exec_driver_sql("SELECT * FROM api_keys").all()
    assert secret not in str(kept)
    assert secret.removeprefix(keys.PREFIX) not in str(kept)


def test_keys_from_the_command_line(
    guarded: Guarded, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def ran(*words: str) -> Any:
        status = main(["keys", *words, "--folder", str(tmp_path), "--json"])
        out = capsys.readouterr().out
        return json.loads(out) if status == 0 else (status, json.loads(out)["error"]["parameter"])

    url = f"sqlite:///{tmp_path / 'service.sqlite'}"
    assert not keys.are_needed("auto", "127.0.0.1", url)
    assert not keys.are_needed("off", "0.0.0.0", url)
    for choice, host in (("auto", "0.0.0.0"), ("auto", "institute.example"), ("on", "::1")):
        with pytest.raises(SpecError, match="no API key"):
            keys.are_needed(choice, host, url)
    made = ran("create", "--owner", "ann", "--scope", "read", "--name", "laptop")
    assert made["secret"].startswith("brdf_")
    (listed,) = ran("list")["keys"]
    assert (listed["owner"], listed["scope"], listed["revoked"]) == ("ann", "read", None)
    for host in ("127.0.0.1", "0.0.0.0", "localhost"):
        assert keys.are_needed("auto", host, url)
    assert ran("revoke", listed["id"])["keys"][0]["revoked"]
    assert not keys.are_needed("auto", "localhost", url)
    for words, parameter in (
        (("create",), "owner"), (("revoke",), "id"), (("revoke", "x"), "id"), (("list", "x"), "id"),
        (("create", "--owner", "a\nb"), "owner"), (("list", "--owner", "x"), "owner"),
    ):  # fmt: skip
        assert ran(*words) == (2, parameter)
    # The command that has a service do the work takes its key from the environment.
    table = tmp_path / "paint.csv"
    table.write_bytes(small_table())
    words = ["--server", guarded.url, "info", str(table), "--json"]
    monkeypatch.delenv("BRDF_FITTER_KEY", raising=False)
    assert main(words) == 2
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "key-needed"
    monkeypatch.setenv("BRDF_FITTER_KEY", guarded.secrets["bob", "write"])
    assert main(words) == 0


def test_rates() -> None:
    rates = Rates(2.0, 4)
    taken = [rates.take("a", 100.0) for _ in range(6)]
    assert [one.retry_after for one in taken if one] == [0, 0, 0, 0, 1, 1]
    assert [one.headers["RateLimit"] for one in taken if one][:5] == [
        f'"requests";r={left};t={full}' for left, full in ((3, 1), (2, 1), (1, 2), (0, 2), (0, 2))
    ]
    assert taken[0] is not None
    assert taken[0].headers["RateLimit-Policy"] == '"requests";q=4;w=2'
    other, later = rates.take("b", 100.0), rates.take("a", 100.5)
    assert other is not None
    assert later is not None
    assert (other.retry_after, later.retry_after) == (0, 0)
    assert Rates(0.0, 4).take("a") is None


def test_who_asks_too_often_waits(serving: Callable[..., Any]) -> None:
    client = serving(requests_per_second=0.5, burst=3)
    answers = [client.get("/v1/tables") for _ in range(5)]
    assert [answer.status_code for answer in answers] == [200, 200, 200, 429, 429]
    assert all(answer.headers["ratelimit-policy"] == '"requests";q=3;w=6' for answer in answers)
    refused = answers[-1]
    assert refused.json()["code"] == "too-many-requests"
    assert int(refused.headers["retry-after"]) >= 1
    assert client.get("/healthz").status_code == 200
