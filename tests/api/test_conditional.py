"""Who has an answer already, who would rather wait, and who wants the next page."""

from __future__ import annotations

from typing import Any

import pytest

from api.conditional import matches


def test_what_is_there_already_is_not_sent_again(client: Any, table: str, fit: str) -> None:
    check = f"/v1/tables/{table}/check"
    for path in (f"/v1/tables/{table}", check, f"/v1/fits/{fit}", f"/v1/models/{fit}", "/v1/model-families"):
        first = client.get(path)
        tag = first.headers["etag"]
        again = client.get(path, headers={"if-none-match": f'"other", W/{tag}'})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
        assert "content-length" not in again.headers
        other = client.get(path, headers={"if-none-match": '"other"'})
        assert (other.status_code, other.content) == (200, first.content)
    assert "etag" not in client.get("/v1/tables/nothing").headers
    assert client.get("/v1/tables/nothing", headers={"if-none-match": "*"}).status_code == 404


@pytest.mark.parametrize(
    ("header", "same"),
    [('"a"', True), ('W/"a"', True), ('"b", "a"', True), ("*", True), ("a", False), ("", False)],
)  # fmt: skip
def test_tags_are_compared(header: str, same: bool) -> None:
    assert matches(header, '"a"') == same


def test_a_small_fit_is_waited_for(client: Any, table: str, wait: Any) -> None:
    wanted = {"table": table, "model": "oren_nayar"}
    answer = client.post("/v1/fits", json=wanted, headers={"prefer": "respond-async; x=1, wait=60"})
    assert answer.status_code == 200
    assert answer.headers["preference-applied"] == "wait=60"
    assert answer.json()["state"] == "done"
    assert client.get(answer.headers["location"]).json() == answer.json()
    at_once = client.post("/v1/fits", json=wanted, headers={"prefer": "wait=0"})
    assert (at_once.status_code, at_once.headers["preference-applied"]) == (202, "wait=0")
    plain = client.post("/v1/fits", json=wanted, headers={"prefer": "wait=soon"})
    assert plain.status_code == 202
    assert "preference-applied" not in plain.headers
    for queued in (at_once, plain):
        assert wait(client, queued.headers["location"])["state"] == "done"


def test_pages_lead_to_each_other(client: Any) -> None:
    for k in range(5):
        values = {"kd": 0.1 * k, "ks": 0.05, "alpha": 0.2}
        client.post("/v1/models", json={"model": "ward", "values": values})
    everything = client.get("/v1/models?limit=200").json()["items"]
    seen: list[Any] = []
    path: str | None = "/v1/models?limit=2"
    while path is not None:
        answer = client.get(path)
        seen += answer.json()["items"]
        links = {relation: link["url"] for relation, link in answer.links.items()}
        if "prev" in links:
            before = client.get(links["prev"])
            assert before.links["next"]["url"] == path
        assert client.get(links["last"]).json()["items"][-1] == everything[-1]
        assert client.get(links["first"]).json()["items"] == everything[:2]
        path = links.get("next")
    assert seen == everything
    kept = client.get("/v1/jobs?state=failed&limit=1").links["first"]["url"]
    assert kept == "/v1/jobs?state=failed&limit=1&offset=0"
