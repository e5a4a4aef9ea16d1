"""The schema holds: Schemathesis makes requests from it, and no answer may be a 5xx or undocumented."""

from __future__ import annotations

import warnings
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable

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
CASES = 8


def test_every_error_is_documented_as_a_problem(client: Any) -> None:
    for path, item in client.app.openapi()["paths"].items():
        for method, operation in item.items():
            assert any(status.startswith("2") for status in operation["responses"]), (method, path)
            for status, answer in operation["responses"].items():
                if int(status) >= 400:
                    assert list(answer["content"]) == ["application/problem+json"], (method, path, status)


@pytest.mark.parametrize("mode", ["positive", "negative"])
def test_schemathesis(
    client: Any, table: str, fit: str, model: str, job: dict[str, Any], mode: str
) -> None:
    """Requests that keep to the schema, and requests that break it.

    Ids of things that exist stand in for half of the made ones, so that more than 404 is reached.
    """
    known = {"tables": table, "fits": fit, "models": model, "jobs": job["id"]}

    async def app(scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] == "lifespan":
            raise NotImplementedError("the fixture has started the application")
        await client.app(scope, receive, send)

    def put_known(case: Any) -> None:
        noun = (case.path.split("/") + [""] * 3)[2]
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
            if existing:
                put_known(case)
            case.validate_response(case.call(), checks=CHECKS)

        try:
            probe()
        except Unsatisfiable:
            # Nothing that an operation without parameters takes can be wrong.
            assert mode == "negative"
    print(f"{tried} cases, {mode}")
    assert tried > 60
