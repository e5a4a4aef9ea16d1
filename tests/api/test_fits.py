"""Fits: from an uploaded table to parameters, a model, a report."""

from __future__ import annotations

import io
import time
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fitter
from fitter.calibration import Calibration
from fitter.fitting import FitResult


def test_a_fit_may_have_a_budget(client: Any, table: str) -> None:
    answer = client.post("/v1/fits", json={"table": table, "model": "oren_nayar", "budget_seconds": 5})
    assert answer.status_code == 202, answer.text
    assert answer.json()["request"]["specs"][0]["budget_seconds"] == 5
    client.post(f"{answer.headers['location']}/cancel")


def test_posteriors_have_limits(client: Any, fit: str) -> None:
    for asked, parameter in (
        ({"ensembles": 32, "walkers": 1024}, "walkers"), ({"keep": 1_000_000}, "keep"),
        ({"budget_seconds": 80_000}, "budget_seconds"),
    ):  # fmt: skip
        for path, sent in (("/v1/posteriors", asked), ("/v1/calibrations", {"posterior": asked})):
            answer = client.post(path, json={"fit": fit, **sent})
            assert (answer.status_code, answer.json()["code"]) == (422, "beyond-limit")
            assert answer.json()["parameter"] == parameter


def test_calibrations_end(client: Any, fit: str) -> None:
    answer = client.post("/v1/calibrations", json={"fit": fit, "time_limit_seconds": 80_000})
    assert (answer.status_code, answer.json()["parameter"]) == (422, "time_limit_seconds")
    for asked, limit in (({}, 14_400.0), ({"time_limit_seconds": 7}, 7.0)):
        answer = client.post("/v1/calibrations", json={"fit": fit, "simulations": 10_000, **asked})
        assert answer.json()["request"]["spec"]["time_limit_seconds"] == limit
        client.post(f"{answer.headers['location']}/cancel")


def test_job_holds_what_came_of_each_model(job: dict[str, Any]) -> None:
    assert job["state"] == "done"
    assert job["progress"]["share"] == 1
    done, failed = job["results"]
    assert (done["model"], done["kind"]) == ("oren_nayar", "fit")
    assert done["links"]["self"] == f"/v1/fits/{done['id']}"
    assert failed["model"] == "ward"
    assert failed["problem"]["detail"]
    assert job["created"] <= job["started"] <= job["finished"]


def test_fit_is_the_librarys(client: Any, fit: str, table_bytes: bytes) -> None:
    document = client.get(f"/v1/fits/{fit}").json()
    read = FitResult.from_dict(document)
    same = fitter.fit(fitter.load(table_bytes), "oren_nayar", fixed={"sigma": 0.1})
    np.testing.assert_allclose(read.parameters["rho"].value, same.parameters["rho"].value, rtol=1e-9)
    assert document["id"] == fit
    assert document["posteriors"] == []
    summary = next(item for item in client.get("/v1/fits").json()["items"] if item["id"] == fit)
    assert summary["status"] == document["status"]
    assert summary["model"] == "oren_nayar"


def test_fit_is_a_model(client: Any, fit: str) -> None:
    model = client.get(f"/v1/models/{fit}").json()
    assert model["origin"] == "fit"
    assert model["links"]["fit"] == f"/v1/fits/{fit}"
    found = client.post(f"/v1/models/{fit}/evaluate", json={"wi": [0, 0, 1], "wo": [0, 0, 1]}).json()
    assert np.isfinite(found["values"]).all()


def test_auto_links_the_fits_of_the_best_models_and_the_comparison(
    client: Any, table: str, wait: Callable[..., Any]
) -> None:
    wanted = {"table": table, "model": "auto", "candidates": ["lambert", "oren_nayar"], "folds": 3}
    answer = client.post("/v1/fits", json=wanted)
    assert answer.status_code == 202, answer.text
    job = wait(client, answer.headers["location"])
    assert job["state"] == "done", job
    *fits, compared = job["results"]
    assert compared["kind"] == "selection"
    assert fits[0]["model"] == compared["chosen"]
    assert {one["model"] for one in compared["ranking"]} == {"lambert", "oren_nayar"}
    assert compared["folds"]["folds"] == 3
    document = client.get(fits[0]["links"]["self"]).json()
    assert document["evidence"]["selection"]["sentences"] == compared["sentences"]


@pytest.mark.parametrize(
    "body",
    [
        {"model": "auto", "fixed": {"alpha": 0.1}}, {"model": "auto", "candidates": ["glass"]},
        {"model": "auto", "candidates": ["smooth_dielectric"]}, {"model": "auto", "folds": 2},
        {"model": "ward", "candidates": ["ward"]}, {"models": ["auto", "ward"]},
        {"model": "auto", "models": ["ward"]},
    ],
)  # fmt: skip
def test_auto_refuses_what_makes_no_sense(client: Any, table: str, body: dict[str, Any]) -> None:
    answer = client.post("/v1/fits", json={"table": table, **body})
    assert answer.status_code == 422, answer.text


def test_reports(client: Any, fit: str) -> None:
    page = client.get(f"/v1/fits/{fit}/report.html")
    paper = client.get(f"/v1/fits/{fit}/report.pdf")
    assert paper.headers["content-type"] == "application/pdf"
    assert paper.content.startswith(b"%PDF-")
    for accept, content in (
        ("application/pdf", paper.content), ("text/html, application/pdf;q=0.5", page.content),
        ("*/*", client.get(f"/v1/fits/{fit}/report.json").content),
    ):  # fmt: skip
        assert client.get(f"/v1/fits/{fit}/report", headers={"Accept": accept}).content == content
    assert page.status_code == 200, page.text
    assert page.headers["content-type"].startswith("text/html")
    assert "oren" in page.text.lower()
    record = client.get(f"/v1/fits/{fit}/report.json")
    assert record.json()["kind"] == "brdf-fitter/report"
    assert client.get(f"/v1/fits/{fit}/report.html").content == page.content


@pytest.mark.long
def test_a_report_that_an_earlier_version_kept_is_made_anew(serving: Any, table_bytes: bytes) -> None:
    service = serving()
    table = service.post("/v1/tables", content=table_bytes).json()["id"]
    asked = {"table": table, "model": "oren_nayar"}
    job = service.post("/v1/fits", json=asked, headers={"Prefer": "wait=60"}).json()
    fit = job["results"][0]["id"]
    results = service.app.state.service.results
    results.write_report(fit, "json", b'{"kind": "brdf-fitter/report", "version": 1}')
    assert service.get(f"/v1/fits/{fit}/report.pdf").content.startswith(b"%PDF-")
    assert service.get(f"/v1/fits/{fit}/report.json").json()["version"] == 2


@pytest.mark.parametrize(
    "body",
    [
        {}, {"model": "ward", "models": ["ward"]}, {"models": []}, {"model": "glass"}, {"model": "ward:9"},
        {"models": ["ward"] * 17}, {"model": "ward", "metric": "best"}, {"model": "ward", "seed": -1},
        {"model": "ward", "bounds": {"alpha": [1]}}, {"model": "ward", "subset": 1},
        {"model": "ward", "x": 1}, {"model": {"family": "ward", "ndf": "ggx"}}, {"model": None},
    ],
)  # fmt: skip
def test_bad_fit_requests(client: Any, table: str, body: dict[str, Any]) -> None:
    answer = client.post("/v1/fits", json={"table": table, **body})
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"


def test_fit_that_fails_is_a_failed_job(client: Any, table: str, wait: Callable[..., Any]) -> None:
    answer = client.post("/v1/fits", json={"table": table, "model": "ward", "select": {"channels": ["X"]}})
    job = wait(client, answer.headers["location"])
    assert job["state"] == "failed"
    assert job["problem"]["code"]
    assert "Traceback" not in str(job)


def test_unknown_ids(client: Any) -> None:
    for id in ("0" * 32, "x", "..%2f..%2fetc", "%00", "%ff"):
        for route in ("tables", "fits", "models", "jobs", "posteriors"):
            answer = client.get(f"/v1/{route}/{id}")
            assert answer.status_code == 404
            assert answer.json()["status"] == 404
    for body in ({"table": "0" * 32, "model": "ward"}, {"table": "x", "model": "ward"}):
        assert client.post("/v1/fits", json=body).status_code == 404
    assert client.post("/v1/posteriors", json={"fit": "0" * 32}).status_code == 404
    assert client.post("/v1/posteriors", json={"fit": 5}).status_code == 422


def test_results_outlive_their_table(client: Any, table_bytes: bytes, wait: Callable[..., Any]) -> None:
    table = client.post("/v1/tables", content=table_bytes).json()["id"]
    answer = client.post("/v1/fits", json={"table": table, "model": "oren_nayar", "fixed": {"sigma": 0.2}})
    fit = wait(client, answer.headers["location"])["results"][0]["id"]
    assert client.delete(f"/v1/tables/{table}").status_code == 204
    assert client.get(f"/v1/fits/{fit}").status_code == 200
    assert client.get(f"/v1/fits/{fit}/report.html").json()["code"] == "table-gone"
    assert client.post("/v1/posteriors", json={"fit": fit}).json()["code"] == "table-gone"


def test_calibration(client: Any, fit: str, wait: Callable[..., Any]) -> None:
    posterior = {"ess": 50, "rhat": 1.2, "keep": 300, "max_samples": 200, "budget_seconds": 2}
    wanted = {"fit": fit, "simulations": 1, "draws": 19, "posterior": posterior}
    answer = client.post("/v1/calibrations", json=wanted)
    assert answer.status_code == 202, answer.text
    job = wait(client, answer.headers["location"])
    assert job["state"] == "done", job
    (result,) = job["results"]
    document = client.get(result["links"]["self"]).json()
    assert Calibration.from_dict(document).simulations == 1
    assert document["links"]["fit"] == f"/v1/fits/{fit}"
    (first,) = client.get("/v1/calibrations").json()["items"]
    assert (first["id"], first["status"], first["links"]) == (
        document["id"], document["status"], document["links"]
    )  # fmt: skip
    assert {"rho[R]", "rho[G]", "rho[B]", "relative_noise[R]"} <= set(document["labels"])
    picture = client.get(result["links"]["picture"])
    assert picture.headers["content-type"] == "image/png"
    assert picture.content.startswith(b"\x89PNG")
    assert client.get(f"/v1/calibrations/{'0' * 32}").status_code == 404
    for body in ({"fit": "0" * 32}, {"fit": fit, "simulations": 0}, {"fit": fit, "around": -1}):
        assert client.post("/v1/calibrations", json=body).status_code in (404, 422)
    refused = client.post("/v1/calibrations", json={"fit": fit, "noise": "table", "simulations": 1})
    problem = wait(client, refused.headers["location"])["problem"]
    assert problem["code"] == "noise-needs-sigma"


@pytest.mark.long
def test_posterior(client: Any, table: str, fit: str, wait: Callable[..., Any]) -> None:
    wanted = {"fit": fit, "ess": 50, "rhat": 1.2, "budget_seconds": 10, "keep": 100}
    answer = client.post("/v1/posteriors", json=wanted)
    assert answer.status_code == 202
    job = wait(client, answer.headers["location"])
    assert job["state"] == "done", job
    here = job["results"][0]["links"]["self"]
    document = client.get(here).json()
    assert document["kind"] == "brdf-fitter/posterior"
    assert document["links"]["fit"] == f"/v1/fits/{fit}"
    assert client.get(f"/v1/fits/{fit}").json()["posteriors"] == [document["id"]]
    end = time.monotonic() + 20  # it is counted a moment after it can be read
    while 'brdf_acceptance_count{sampler="posterior"}' not in client.get("/metrics").text:
        assert time.monotonic() < end
        time.sleep(0.05)
    first = client.get("/v1/posteriors?limit=1").json()["items"][0]
    assert (first["id"], first["fit"], first["links"]) == (document["id"], fit, document["links"])
    assert client.get(f"/v1/fits/{fit}/report.html").status_code == 200
    export = document["links"]["export"].format(format="c")
    drawn = client.get(export, params={"draws": 3, "unconverged": True})
    assert drawn.headers["content-type"] == "application/zip"
    inside = zipfile.ZipFile(io.BytesIO(drawn.content)).namelist()
    assert inside == ["draw_0001.c", "draw_0002.c", "draw_0003.c", "draws.json"]
    assert client.get(export).status_code == 422  # how many?
