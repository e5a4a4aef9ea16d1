"""The schema holds: Schemathesis makes requests from it, and no answer may be a 5xx or undocumented."""

from __future__ import annotations

import warnings
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable

import fitter
from api import keys
from api.rows import ModelRow
from api.store import new_id

from . import schema_snapshot

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import schemathesis
    from schemathesis.checks import not_a_server_error
    from schemathesis.specs.openapi.checks import (
        allow_header_conformance,
        content_type_conformance,
        response_headers_conformance,
        response_schema_conformance,
        status_code_conformance,
        unsupported_method,
    )

CHECKS = [
    not_a_server_error, status_code_conformance, content_type_conformance, response_schema_conformance,
    response_headers_conformance, unsupported_method, allow_header_conformance,
]  # fmt: skip
#: Cases for each operation and mode.
CASES = 5
#: Hypothesis blames a strategy for whatever moves Python's global generator while it draws. The service's own
#: threads run beside it, and what they call may use that generator: seen once in some fifty runs.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")


def test_every_error_is_documented_as_a_problem(client: Any) -> None:
    for path, item in client.app.openapi()["paths"].items():
        for method, operation in item.items():
            assert any(status.startswith("2") for status in operation["responses"]), (method, path)
            for status, answer in operation["responses"].items():
                if int(status) >= 400:
                    assert list(answer["content"]) == ["application/problem+json"], (method, path, status)


def test_the_committed_document_is_this_one(client: Any) -> None:
    made = schema_snapshot.text(client.app.openapi())
    assert made == schema_snapshot.FILE.read_text(), (
        "docs/openapi.json is another interface: if that is meant, run `python -m tests.api.schema_snapshot`"
    )


@pytest.fixture(scope="module")
def idle(serving_once: Any, table_bytes: bytes) -> tuple[Any, dict[str, str]]:
    """A service whose jobs all wait, and what there is: a fit's row is enough to ask for more of it."""
    client = serving_once(workers=0)
    table = client.post("/v1/tables", content=table_bytes).json()["id"]
    document = fitter.models.create("ward", kd=0.1, ks=0.05, alpha=0.2).to_dict()
    summary = {"status": "converged", "message": "", "metrics": {}, "seconds": 1.0}
    fit = ModelRow(
        id=new_id(), created=0.0, origin="fit", name="ward", document=document, table_id=table,
        job_id=new_id(), summary=summary,
    )  # fmt: skip
    client.app.state.service.store.add(fit)
    job = client.post("/v1/fits", json={"table": table, "model": "ward"}).json()["id"]
    return client, {"tables": table, "fits": fit.id, "jobs": job}


def test_every_operation_has_an_example_that_works(
    client: Any, table: str, fit: str, model: str, job: dict[str, Any], idle: tuple[Any, dict[str, str]]
) -> None:
    """Each documented example, sent with ids of things that exist, gets the documented status."""
    document = client.app.openapi()
    there = {"tables": table, "fits": fit, "models": model, "jobs": job["id"]}
    example_id = "0123456789abcdef0123456789abcdef"
    tried: list[str] = []
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            where = f"{method.upper()} {path}"
            parameters = operation["parameters"]
            for one in parameters:
                assert not one["required"] or "example" in one, (where, one["name"])
            url, noun = path, (path.split("/") + [""] * 3)[2]
            if "{id}" in url and (noun not in there or method == "delete"):
                continue  # made in other tests, as they take their time; and what others need stays
            if "report" in url:
                continue
            starts = "202" in operation["responses"]
            asked, known = idle if starts else (client, there)
            for one in parameters:
                if one["in"] == "path":
                    value = known[noun] if one["name"] == "id" else one["example"]
                    url = url.replace(f"{{{one['name']}}}", str(value))
            query = {p["name"]: p["example"] for p in parameters if p["in"] == "query" and "example" in p}
            content = operation.get("requestBody", {}).get("content", {})
            sent: dict[str, Any] = {}
            if "text/plain" in content:
                text = content["text/plain"]["example"]
                sent = {"content": text, "headers": {"content-type": "text/plain"}}
            elif content:
                body = content["application/json"]
                name = body["schema"].get("$ref", "").rpartition("/")[2]
                example = body.get("example") or document["components"]["schemas"][name]["example"]
                ids = {"table": known["tables"], "fit": known["fits"]}
                sent = {"json": {k: ids.get(k, v) if v == example_id else v for k, v in example.items()}}
            answer = asked.request(method, url, params=query, **sent)
            documented = [int(status) for status in operation["responses"] if status.startswith("2")]
            assert answer.status_code in documented, (where, answer.text)
            tried.append(where)
    assert len(tried) >= 30, tried


def test_what_takes_nothing_shows_its_answer(client: Any) -> None:
    """Every operation has an example: of what it takes, or else of what it answers."""
    document = client.app.openapi()
    shown: list[str] = []
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            if "requestBody" in operation or any("example" in one for one in operation["parameters"]):
                continue
            ((kind, answer),) = operation["responses"]["200"]["content"].items()
            came = client.request(method, path)
            assert came.headers["content-type"].startswith(kind)
            example, found = answer["example"], came.json() if kind == "application/json" else came.text
            if isinstance(example, list):
                assert all(one in found for one in example), path
            elif isinstance(example, str):
                assert example.splitlines()[0] in found.splitlines(), path
            else:
                assert example == found, path
            shown.append(path)
    assert set(shown) == {"/healthz", "/readyz", "/metrics", "/v1/export-targets", "/v1/model-families"}


@pytest.fixture(scope="module")
def guarded(serving_once: Any, table_bytes: bytes) -> tuple[Any, dict[str, str], dict[str, str]]:
    """A service that asks for keys, the header that has one, and what there is."""
    client = serving_once(keys=True)
    _, secret = keys.create(client.app.state.service.store, "ann", "admin")
    header = {"Authorization": f"Bearer {secret}"}
    table = client.post("/v1/tables", content=table_bytes, headers=header).json()["id"]
    values = {"model": "ward", "values": {"kd": 0.1, "ks": 0.05, "alpha": 0.2}}
    model = client.post("/v1/models", json=values, headers=header).json()["id"]
    return client, header, {"tables": table, "models": model}


@pytest.mark.long
@pytest.mark.parametrize("mode", ["positive", "negative"])
def test_schemathesis(
    client: Any, table: str, fit: str, model: str, job: dict[str, Any], idle: tuple[Any, dict[str, str]],
    mode: str,
) -> None:  # fmt: skip
    """Requests that keep to the schema, and requests that break it.

    Ids of things that exist stand in for half of the made ones, so that more than 404 is reached.
    """
    there = {"tables": table, "fits": fit, "models": model, "jobs": job["id"]}
    # What breaks the schema gets no further than that.
    asked, known = (client, there) if mode == "positive" else idle
    assert probed(asked, {**known, "fits": there["fits"]}, mode, {}) > 60


@pytest.mark.parametrize("mode", ["positive", pytest.param("negative", marks=pytest.mark.long)])
def test_schemathesis_with_keys(guarded: tuple[Any, dict[str, str], dict[str, str]], mode: str) -> None:
    """The same where keys are asked for, with a key and without."""
    client, header, known = guarded
    assert probed(client, known, mode, header) > 60


def probed(client: Any, known: dict[str, str], mode: str, header: dict[str, str]) -> int:
    """Try every operation; how many cases that was. ``header`` : half of the requests have it."""

    async def app(scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] == "lifespan":
            raise NotImplementedError("the fixture has started the application")
        await client.app(scope, receive, send)

    def prepare(case: Any, existing: bool) -> None:
        noun = (case.path.split("/") + [""] * 3)[2]
        if existing:
            case.headers.update(header)
            case.headers.pop("Idempotency-Key", None)
            if noun in known and "{id}" in case.path and case.method.lower() != "delete":
                case.path_parameters["id"] = known[noun]

    schema = schemathesis.openapi.from_asgi("/openapi.json", app)
    tried = 0
    for result in schema.get_all_operations():
        made = result.ok().as_strategy(generation_mode=getattr(schemathesis.GenerationMode, mode.upper()))

        @settings(
            max_examples=CASES, database=None, derandomize=True, phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )  # fmt: skip
        @given(case=made, existing=st.booleans())
        def probe(case: Any, existing: bool) -> None:
            nonlocal tried
            tried += 1
            prepare(case, existing)
            case.validate_response(case.call(), checks=CHECKS)

        try:
            probe()
        except Unsatisfiable:
            # Nothing that an operation without parameters takes can be wrong.
            assert mode == "negative"
    print(f"{tried} cases, {mode}")
    return tried
