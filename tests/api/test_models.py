"""Models: uploaded and fitted ones answer as the library does."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest

from fitter import models

VALUES = {"kd": [0.1, 0.2, 0.3], "ks": 0.05, "alpha": 0.2}
WI, WO = [0.6, 0.0, 0.8], [[-0.6, 0.0, 0.8], [0.0, 0.0, 1.0], [0.0, 0.6, -0.8]]


@pytest.fixture(scope="module")
def ward() -> Any:
    return models.create("ward", **VALUES)


def test_uploaded_model_is_kept(client: Any, ward: Any) -> None:
    answer = client.post("/v1/models", json={"model": {"family": "ward"}, "values": VALUES})
    assert answer.status_code == 201
    found = client.get(answer.headers["location"]).json()
    assert found["origin"] == "upload"
    assert found["values"] == ward.to_dict()["values"]
    assert found["id"] in [item["id"] for item in client.get("/v1/models").json()["items"]]


def test_verbs_are_the_librarys(client: Any, model: str, ward: Any) -> None:
    def ask(verb: str, **body: Any) -> Any:
        answer = client.post(f"/v1/models/{model}/{verb}", json=body)
        assert answer.status_code == 200, answer.text
        return answer.json()

    wi, wo = np.tile(WI, (3, 1)), np.array(WO)
    np.testing.assert_allclose(ask("evaluate", wi=WI, wo=WO)["values"], ward.evaluate(wi, wo), rtol=1e-12)
    assert ask("evaluate", wi=WI, wo=WO)["values"][2] == [0, 0, 0]
    np.testing.assert_allclose(ask("pdf", wi=WI, wo=WO)["values"], ward.pdf(wi, wo), rtol=1e-12)
    np.testing.assert_allclose(ask("albedo", wi=[WI, WI])["values"], ward.albedo(wi[:2]), rtol=1e-12)
    drawn = ward.sample(np.array(WI), 20, seed=5)
    found = ask("sample", wi=WI, n=20, seed=5)
    np.testing.assert_allclose(found["wo"], drawn.wo, rtol=1e-12)
    np.testing.assert_allclose(found["weight"], drawn.weight, rtol=1e-12)


def test_a_model_that_transmits(client: Any) -> None:
    """Light on both sides of a rough dielectric, and ideal components told apart from densities."""
    values = {"eta": 1.5, "alpha": 0.4}
    made = client.post("/v1/models", json={"model": "rough_dielectric", "values": values}).json()
    ours = models.create("rough_dielectric", **values)
    below = [-0.4, 0.1, -np.sqrt(0.83)]
    ask = client.post(f"/v1/models/{made['id']}/evaluate", json={"wi": WI, "wo": [below]}).json()
    np.testing.assert_allclose(ask["values"], ours.evaluate([WI], [below]), rtol=1e-12)
    assert ask["values"][0][0] > 0
    albedo = client.post(f"/v1/models/{made['id']}/albedo", json={"wi": WI}).json()
    assert 0.8 < albedo["values"][0][0] + albedo["transmittance"][0][0] <= 1.0
    mirror = client.post("/v1/models", json={"model": "specular", "values": {"ks": 0.9}}).json()
    drawn = client.post(f"/v1/models/{mirror['id']}/sample", json={"wi": WI, "n": 3, "seed": 1}).json()
    assert drawn["is_delta"] == [True] * 3
    np.testing.assert_allclose(drawn["wo"], np.tile([-0.6, 0.0, 0.8], (3, 1)), atol=1e-15)
    np.testing.assert_allclose(drawn["weight"], 0.9, rtol=1e-12)
    opaque = client.post(f"/v1/models/{mirror['id']}/albedo", json={"wi": WI}).json()
    assert opaque["transmittance"] is None


def test_a_sum_of_models(client: Any) -> None:
    values = {"a_ks": 0.2, "a_alpha": 0.1, "b_kd": [0.1, 0.2, 0.3]}
    made = client.post("/v1/models", json={"model": "sum(ward:no_diffuse, lambert)", "values": values})
    assert made.status_code == 201, made.text
    found = client.post(f"{made.headers['location']}/evaluate", json={"wi": WI, "wo": WO}).json()
    ward = models.create("ward", kd=[0.1, 0.2, 0.3], ks=0.2, alpha=0.1)
    np.testing.assert_allclose(found["values"], ward.evaluate(np.tile(WI, (3, 1)), WO), rtol=1e-12)


def test_binary_in_and_out(client: Any, model: str, ward: Any) -> None:
    rng = np.random.default_rng(0)
    both = np.abs(rng.standard_normal((2, 1000, 3)))
    both /= np.linalg.norm(both, axis=2, keepdims=True)
    body = io.BytesIO()
    np.save(body, both)
    headers = {"content-type": "application/x-npy", "accept": "application/x-npy"}
    answer = client.post(f"/v1/models/{model}/evaluate", content=body.getvalue(), headers=headers)
    found = np.load(io.BytesIO(answer.content), allow_pickle=False)
    np.testing.assert_allclose(found, ward.evaluate(both[0], both[1]), rtol=1e-12)
    assert found.dtype == np.float64
    preferred = {**headers, "accept": "application/json, application/x-npy"}
    as_json = client.post(f"/v1/models/{model}/evaluate", content=body.getvalue(), headers=preferred)
    assert as_json.headers["content-type"] == "application/json"


@pytest.mark.parametrize(
    "body",
    [
        {"model": "glass", "values": {}}, {"model": "ward", "values": {"gloss": 1}},
        {"model": "ward", "values": {"channels": 1}}, {"model": "ward", "values": {"alpha": -1}},
        {"model": "ward", "values": {"kd": [1, 2], "ks": [1, 2, 3]}},
        {"model": "ward", "values": {"kd": []}},
        {"model": "ward", "channels": ["R", "R"], "values": {}},
        {"model": "ward", "channels": [], "values": {}},
        {"model": "ward", "channels": ["R", "G"], "values": {"kd": [1, 2, 3]}}, {"model": 5, "values": {}},
        {"model": "ward", "values": {"kd": "x"}}, {"model": "", "values": {}}, {"values": {}}, [],
        {"model": {"family": "ward", "lobes": 3}, "values": {}},
        {"model": "sum(lambert)", "values": {}}, {"model": "sum(lambert, lambert", "values": {}},
        {"model": "sum(sum(sum(sum(sum(lambert,lambert),phong),phong),phong),phong)", "values": {}},
        {"model": "torrance_sparrow:blinn:anisotropic", "values": {}},
        {"model": "ward", "values": {}, "x": 1},
    ],
)  # fmt: skip
def test_bad_models(client: Any, body: Any) -> None:
    answer = client.post("/v1/models", json=body)
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize(
    "text",
    ['{"model": "ward", "values": {"kd": NaN}}', '{"model": "\\ud800", "values": {}}', '{"a"', "[" * 10**5],
)
def test_json_that_is_none(client: Any, text: str) -> None:
    answer = client.post("/v1/models", content=text, headers={"content-type": "application/json"})
    assert answer.status_code in (400, 422)


def test_limits(serving: Any) -> None:
    small = serving(max_pairs=2, max_draws=3, max_albedo_directions=1, max_body_bytes=2000)
    id = small.post("/v1/models", json={"model": "oren_nayar", "values": {}}).json()["id"]
    here = f"/v1/models/{id}"
    three = [[0, 0, 1]] * 3
    for verb, body, code in (
        ("evaluate", {"wi": three, "wo": three}, "too-many-directions"),
        ("albedo", {"wi": three}, "too-many-directions"),
        ("sample", {"wi": [0, 0, 1], "n": 4, "seed": 0}, "too-many-draws"),
    ):
        assert small.post(f"{here}/{verb}", json=body).json()["code"] == code
    for route in (f"{here}/evaluate", "/v1/models", "/v1/fits"):
        long = small.post(route, content=b" " * 2001, headers={"content-type": "application/json"})
        assert (long.status_code, long.json()["code"]) == (413, "too-large")


def test_families_hold_the_parameter_tables(client: Any) -> None:
    found = {item["name"]: item for item in client.get("/v1/model-families").json()}
    assert {item["family"] for item in found.values()} == {*models.FAMILIES, *models.CANON}
    for name, item in found.items():
        names = [p.name for p in models.parameter_table(name)]
        assert [p["name"] for p in item["parameters"]] == names == list(item["values_schema"]["properties"])
    two = client.get("/v1/model-families/lafortune:2").json()
    assert len(two["parameters"]) == len(models.parameter_table("lafortune:2"))
    assert client.get("/v1/model-families/glass").status_code == 422
