"""Scenes: planned, rendered, read, and what is said of those that make no sense."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.scene.scenes import document


def small(**changes: Any) -> dict[str, Any]:
    found = document(lights=document()["lights"][:1], **changes)
    return {**found, "camera": {**found["camera"], "width": 16, "height": 12}}


def test_a_plan_is_answered_at_once(client: Any) -> None:
    answer = client.post("/v1/scenes/plan", json={"scene": small(), "tolerance": 0.2})
    assert answer.status_code == 200, answer.text
    plan = answer.json()
    assert (plan["kind"], plan["tolerance"]) == ("brdf-fitter/plan", 0.2)
    assert plan["bound"] <= 0.2
    assert all(one["sentence"] for one in plan["decisions"])


def test_a_scene_is_a_job_whose_picture_is_read(
    client: Any, table: str, model: str, wait: Callable[..., dict[str, Any]]
) -> None:
    materials = {"floor": {"fit": model}, "ball": {"table": table}}
    scene = small(materials=materials, channels=["R", "G", "B"])
    answer = client.post("/v1/scenes/render", json={"scene": scene, "samples": 2, "seed": 3, "plan": True})
    assert answer.status_code == 202, answer.text
    job = wait(client, answer.headers["location"])
    assert (job["state"], job["table"]) == ("done", None), job
    (result,) = job["results"]
    found = client.get(result["links"]["self"]).json()
    assert (found["samples"], found["stopped"], found["seed"]) == (2, "samples", 3)
    assert found["plan"]["decisions"]
    assert client.get(result["links"]["exr"]).content[:4] == b"\x76\x2f\x31\x01"
    assert client.get(result["links"]["picture"]).content.startswith(b"\x89PNG")
    assert client.get("/v1/scenes").json()["items"][0]["id"] == result["id"]


def test_bad_scenes(client: Any) -> None:
    inside = {**small()["camera"], "position": [0, 0.1, 0.7]}
    missing = {"fit": "0" * 32}
    for wrong, status in (
        (small(colour="red"), 422), (small(materials={"floor": missing, "ball": missing}), 404),
        (small(materials={"floor": {"compressed": "/etc/passwd"}, "ball": {"compressed": "x"}}), 422),
        (small(shapes=[{"kind": "mesh", "obj": "/etc/passwd", "material": "floor"}]), 422),
        ({**small(), "camera": inside}, 422),
    ):  # fmt: skip
        for path in ("plan", "render"):
            answer = client.post(f"/v1/scenes/{path}", json={"scene": wrong})
            assert answer.status_code == status, answer.text
            assert answer.headers["content-type"] == "application/problem+json"
    # A precision that a plan chooses, without a plan.
    answer = client.post("/v1/scenes/render", json={"scene": small(), "precision": "auto"})
    assert answer.status_code == 422
    assert "ask for plan" in answer.text
    for part in ("", "/picture.exr", "/picture.png"):
        assert client.get(f"/v1/scenes/{'0' * 32}{part}").status_code == 404


def test_two_pictures_are_compared(client: Any, model: str, wait: Callable[..., dict[str, Any]]) -> None:
    """The numbers are those of their pixels, and noise explains what only the seed makes different."""
    scene = small(materials={"floor": {"fit": model}, "ball": {"fit": model}}, channels=["R", "G", "B"])
    grey = small()
    made: list[str] = []
    for one, seed in ((scene, 1), (scene, 2), (grey, 1)):
        started = client.post("/v1/scenes/render", json={"scene": one, "samples": 8, "seed": seed})
        made.append(wait(client, started.headers["location"])["results"][0]["id"])
    first, second, other = made
    same = client.get(f"/v1/scenes/{first}/difference/{first}").json()
    assert [one["error"] for one in same["numbers"]] == [0.0, 0.0, 0.0]
    found = client.get(f"/v1/scenes/{first}/difference/{second}").json()
    assert found["reference"] == client.get(f"/v1/scenes/{first}").json()["reference"]
    for one in found["numbers"]:
        assert 0 < one["error"] < 3 * one["noise"]
        assert abs(one["bias"]) < one["error"]
    strip = client.get(f"/v1/scenes/{first}/difference/{second}/picture.png")
    assert strip.headers["content-type"] == "image/png"
    assert int.from_bytes(strip.content[16:20], "big") == 3 * 16 + 4  # the width in the PNG's header
    refused = client.get(f"/v1/scenes/{first}/difference/{other}")
    assert (refused.status_code, refused.json()["code"]) == (409, "pictures-differ")
    assert client.get(f"/v1/scenes/{first}/difference/{'0' * 32}").status_code == 404
