"""Tables: list, evaluate, draw, slice."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest

import fitter

WI = [0.6, 0.0, 0.8]
NPY = "application/x-npy"


def as_npy(array: Any) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


@pytest.fixture(scope="module")
def same(table_bytes: bytes) -> fitter.Table:
    """The table as the library reads it."""
    return fitter.load(table_bytes)


def test_list_is_paged(client: Any, table: str) -> None:
    whole = client.get("/v1/tables?limit=200").json()
    assert table in [item["id"] for item in whole["items"]]
    assert whole["total"] == len(whole["items"])
    second = client.get("/v1/tables?limit=1&offset=1").json()
    assert second["items"] == whole["items"][1:2]
    for query in ("limit=0", "limit=201", "offset=-1", "offset=99999999999999999999"):
        assert client.get(f"/v1/tables?{query}").status_code == 422


def test_evaluate_is_the_librarys(client: Any, table: str, same: fitter.Table) -> None:
    wo = [[-0.6, 0.0, 0.8], [0.0, 0.0, 1.0], [0.0, 0.9999, 0.01414178]]
    found = client.post(f"/v1/tables/{table}/evaluate", json={"wi": WI, "wo": wo}).json()
    unit = np.asarray(wo) / np.linalg.norm(wo, axis=1, keepdims=True)
    values, extrapolated = same.evaluate(np.tile(WI, (3, 1)), unit)
    np.testing.assert_allclose(found["values"], values, rtol=1e-12)
    assert found["extrapolated"] == extrapolated.tolist() == [False, False, True]
    assert found["channels"] == ["R", "G", "B"]


def test_evaluate_in_binary(client: Any, table: str, same: fitter.Table) -> None:
    pairs = np.stack([np.tile(WI, (5, 1)), np.tile([0.0, 0.0, 1.0], (5, 1))])
    answer = client.post(
        f"/v1/tables/{table}/evaluate", content=as_npy(pairs), headers={"content-type": NPY, "accept": NPY}
    )
    assert answer.headers["content-type"] == NPY
    found = np.load(io.BytesIO(answer.content), allow_pickle=False)
    np.testing.assert_array_equal(found["value"], same.evaluate(pairs[0], pairs[1])[0])
    assert not found["extrapolated"].any()


def test_samples_are_the_librarys(client: Any, table: str, same: fitter.Table) -> None:
    wanted = {"wi": WI, "n": 50, "seed": 7}
    found = client.post(f"/v1/tables/{table}/samples", json=wanted).json()
    drawn = fitter.TableSampler(same).sample(np.array(WI), 50, seed=7)
    np.testing.assert_array_equal(found["wo"], drawn.wo)
    np.testing.assert_array_equal(found["weight"], drawn.weight)
    assert found["acceptance"] == drawn.acceptance
    binary = client.post(f"/v1/tables/{table}/samples", json=wanted, headers={"accept": NPY})
    np.testing.assert_array_equal(np.load(io.BytesIO(binary.content))["wo"], drawn.wo)
    assert binary.headers["sampling-seed"] == "7"
    assert binary.headers["sampling-evaluations"] == str(drawn.evaluations)
    weighted = client.post(f"/v1/tables/{table}/samples", json={**wanted, "weights": [1, 0, 0]}).json()
    assert weighted["wo"] != found["wo"]


def test_samples_of_several_incidences_and_of_pairs(client: Any, table: str, same: fitter.Table) -> None:
    several = [[0.0, 0.0, 1.0], WI]
    wanted: dict[str, Any] = {"wi": several, "n": 20, "seed": 7}
    found = client.post(f"/v1/tables/{table}/samples", json=wanted).json()
    drawn = fitter.TableSampler(same).sample(np.array(several), 20, seed=7)
    np.testing.assert_array_equal(found["wo"], drawn.wo)
    np.testing.assert_array_equal(found["wi"], np.repeat(several, 20, axis=0))
    binary = client.post(f"/v1/tables/{table}/samples", json=wanted, headers={"accept": NPY})
    np.testing.assert_array_equal(np.load(io.BytesIO(binary.content))["wi"], drawn.wi)
    pairs = client.post(f"/v1/tables/{table}/samples", json={"n": 20, "seed": 7}).json()
    np.testing.assert_array_equal(pairs["wi"], fitter.TableSampler(same).sample_pairs(20, 7).wi)
    answer = client.post(f"/v1/tables/{table}/samples", json={**wanted, "n": 600_000})
    assert answer.json()["code"] == "too-many-draws"


def test_samples_end_with_a_problem_where_the_acceptance_is_hopeless(client: Any, table: str) -> None:
    wanted = {"wi": WI, "n": 1000, "seed": 7, "max_evaluations": 900, "method": "rejection"}
    answer = client.post(f"/v1/tables/{table}/samples", json=wanted)
    assert answer.status_code == 422
    assert answer.json()["code"] == "evaluation-budget"
    assert answer.json()["parameter"] == "max_evaluations"


@pytest.mark.parametrize(
    "change",
    [
        {"n": 0}, {"n": 10_000_000}, {"n": 1e300}, {"seed": -1}, {"seed": 2**63}, {"wi": [0, 0, 0]},
        {"wi": [0.6, 0, -0.8]}, {"wi": [1e300, 0, 0]}, {"wi": [1, 0]}, {"wi": "up"}, {"weights": [1]},
        {"weights": [-1, 1, 1]}, {"method": "magic"}, {"max_evaluations": 0}, {"wi": []},
        {"wi": [WI, [0, 1]]}, {"wi": [WI, [0.6, 0, -0.8]]}, {"n": 10**12}, {"weights": [0, 0, 0]},
        {"wi": [0.999, 0, 0.0447]}, {"colour": 1},
    ],
)  # fmt: skip
def test_bad_samples_requests(client: Any, table: str, change: dict[str, Any]) -> None:
    answer = client.post(f"/v1/tables/{table}/samples", json={"wi": WI, "n": 5, "seed": 1, **change})
    assert answer.status_code == 422
    assert answer.json()["detail"]


def test_unmeasured_incidence_needs_permission(client: Any, table: str) -> None:
    wanted = {"wi": [0.999, 0.0, 0.044710], "n": 5, "seed": 1}
    refused = client.post(f"/v1/tables/{table}/samples", json=wanted)
    assert refused.json()["code"] == "incidence-not-measured"
    allowed = client.post(f"/v1/tables/{table}/samples", json={**wanted, "allow_extrapolated": True})
    assert allowed.status_code == 200


def test_slice_has_its_peak_on_the_specular_side(client: Any, table: str) -> None:
    found = client.get(f"/v1/tables/{table}/slices?theta_i_deg=40&n=180").json()
    peak = found["theta_o_deg"][int(np.argmax(np.asarray(found["values"])[:, 0]))]
    assert 35 <= peak <= 45
    assert found["extrapolated"][0]
    assert not found["extrapolated"][100]
    bad = ("", "theta_i_deg=95", "theta_i_deg=nan", "theta_i_deg=1&phi_i_deg=inf", "theta_i_deg=1&n=1")
    for query in bad:
        assert client.get(f"/v1/tables/{table}/slices?{query}").status_code == 422


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"", 400), (b"{", 400), (b'{"wi": [NaN, 0, 1], "wo": [0, 0, 1]}', 400), (b"[]", 422), (b"{}", 422),
        (b'{"wi": [0, 0, 1]}', 422), (b'{"wi": [0, 0, 1], "wo": [0, 0, 1], "x": 1}', 422),
        (b'{"wi": [0, 0, 1], "wo": []}', 422), (b'{"wi": [[0, 0, 1], [0, 1]], "wo": [0, 0, 1]}', 422),
        (b'{"wi": ["0", "0", "1"], "wo": [0, 0, 1]}', 422), (b'{"wi": [null, 0, 1], "wo": [0, 0, 1]}', 422),
        (b'{"wi": [0, 0, 3], "wo": [0, 0, 1]}', 422), (b'{"wi": [0, 0, -1], "wo": [0, 0, 1]}', 422),
        (b'{"wi": [1e400, 0, 1], "wo": [0, 0, 1]}', 400), (b'{"wi": [0, 0, 1e200], "wo": [0, 0, 1]}', 422),
        (b'{"wi": [[0,0,1],[0,0,1]], "wo": [[0,0,1],[0,0,1],[0,0,1]]}', 422), (b"[" * 100_000, 400),
        (b'{"wi": {"a": 1}, "wo": [0, 0, 1]}', 422), (b'{"wi": [true, false, true], "wo": [0, 0, 1]}', 422),
        (b'{"wi": [123456789012345678901234567890, 0, 1], "wo": [0, 0, 1]}', 422),
        (b'{"\\ud800": 1}', 400), (b"\xff\xfe", 400),
    ],
)  # fmt: skip
def test_bad_bodies(client: Any, table: str, body: bytes, status: int) -> None:
    answer = client.post(f"/v1/tables/{table}/evaluate", content=body)
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize(
    "body",
    [
        b"", b"\x93NUMPY", as_npy(np.zeros(3)), as_npy(np.full((2, 1, 3), np.nan)), as_npy(np.eye(3)),
        as_npy(np.zeros((2, 4, 3), complex)), as_npy(np.array(["a"])), as_npy(np.ones((2, 4, 3)))[:-8],
        as_npy(np.zeros((2, 10**3, 3)))[:100], as_npy(np.zeros((2, 0, 3))),
        as_npy(np.ones((2, 4, 3))).replace(b"(2, 4, 3)", b"(2, 4, -3)"[:9]),
        b"\x93NUMPY\x01\x00\x10\x00" + b"(" * 16, b"\x93NUMPY\x09\x00\x10\x00" + b" " * 16,
    ],
)  # fmt: skip
def test_bad_arrays(client: Any, table: str, body: bytes) -> None:
    answer = client.post(f"/v1/tables/{table}/evaluate", content=body, headers={"content-type": NPY})
    assert answer.status_code in (400, 422), answer.text


def test_pickles_are_not_opened(client: Any, table: str) -> None:
    body = io.BytesIO()
    np.save(body, np.array([{"a": 1}], object), allow_pickle=True)
    answer = client.post(
        f"/v1/tables/{table}/evaluate", content=body.getvalue(), headers={"content-type": NPY}
    )
    assert answer.json()["code"] == "bad-npy"


def test_picture_is_a_png(client: Any, table: str) -> None:
    path = client.get(f"/v1/tables/{table}").json()["links"]["picture"]
    answer = client.get(path)
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "image/png"
    assert answer.content.startswith(b"\x89PNG")
    assert client.get("/v1/tables/none/picture.png").headers["content-type"] == "application/problem+json"
    assert client.get("/v1/tables/none/picture.png").status_code == 404


def test_check_is_the_librarys(client: Any, table: str, same: fitter.Table) -> None:
    assert client.get(f"/v1/tables/{table}").json()["links"]["check"] == f"/v1/tables/{table}/check"
    found = client.get(f"/v1/tables/{table}/check?seed=3").json()
    assert found == fitter.check(same, seed=3).to_dict()
    assert client.get(f"/v1/tables/{table}/check?seed=-1").status_code == 422
    assert client.get("/v1/tables/none/check").status_code == 404


def test_what_the_check_suggests_can_be_asked_for(client: Any) -> None:
    """A file whose azimuths count from the other side and whose gaps are filled, uploaded as it is."""
    rows = ["# quantity: brdf", "theta_i_deg,theta_o_deg,dphi_deg,brdf"]
    for theta_i in (15, 30, 45, 60):
        for theta_o in range(0, 81, 5):
            for dphi in range(0, 360, 30):
                f = 0.05 + (2.0 + 0.1 * theta_i if dphi == 0 and theta_i == theta_o else 0.001 * theta_o)
                rows.append(f"{theta_i},{theta_o},{dphi},{-999 if theta_o == 80 else f}")
    body = "\n".join([*rows, ""]).encode()
    first = client.post("/v1/tables", content=body).json()
    assert first["description"]["masked"]["fill value"] == 4 * 12
    findings = client.get(f"/v1/tables/{first['id']}/check").json()["findings"]
    found = {finding["name"]: finding for finding in findings}
    assert "48 fill values were left out" in found["fill_values"]["sentence"]
    assert found["convention"]["verdict"] == "warning"
    suggested = found["convention"]["numbers"]["suggested"]
    again = client.post(f"/v1/tables?convention={suggested}&fills=keep&negatives=keep", content=body).json()
    assert "fill value" not in again["description"]["masked"]
    assert client.post("/v1/tables?fills=drop", content=body).status_code == 422
    mended = client.post(f"/v1/tables?convention={suggested}", content=body).json()
    found = client.get(f"/v1/tables/{mended['id']}/check").json()["findings"]
    assert {finding["name"]: finding["verdict"] for finding in found}["convention"] == "ok"
