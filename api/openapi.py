"""OpenAPI: what the framework can't know about bodies that are arrays, files or problems."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel

from api.arrow_stream import ARROW
from api.exchange import NPY
from api.guard import is_open, needed
from api.problems import JSON, MEDIA_TYPE

_COMPONENT = {"type": "number", "minimum": -1.01, "maximum": 1.01}
_VECTOR = {"type": "array", "items": _COMPONENT, "minItems": 3, "maxItems": 3}
_VECTORS = {"oneOf": [_VECTOR, {"type": "array", "items": _VECTOR, "minItems": 1}]}
_EXAMPLES = {"wi": [0.6, 0.0, 0.8], "wo": [[-0.6, 0.0, 0.8], [0.0, 0.0, 1.0]]}
_PARAMETERS = {
    "id": "0123456789abcdef0123456789abcdef", "name": "lafortune:2", "theta_i_deg": 30.0,
    "format": "openexr", "draws": 4, "other": "fedcba9876543210fedcba9876543210",
    "Idempotency-Key": "6f0a4e0c-5c44-4d0b-9df9-5c3f1c1f6c55", "limit": 20, "offset": 0,
}  # fmt: skip
_TABLE = """# quantity: brdf
theta_i_deg,theta_o_deg,dphi_deg,brdf_R,brdf_G,brdf_B
0,0,0,0.12,0.15,0.2
0,30,0,0.12,0.15,0.2
30,0,0,0.12,0.15,0.2
30,30,180,0.3,0.33,0.38
"""
_BINARY = {"type": "string", "format": "binary"}
_PROBLEM = {"$ref": "#/components/schemas/ProblemDocument"}


def array_request(*names: str) -> dict[str, Any]:
    """A body of direction arrays, JSON, ``.npy`` or an Arrow stream."""
    schema = {
        "type": "object", "required": list(names), "properties": dict.fromkeys(names, _VECTORS),
        "additionalProperties": False,
    }  # fmt: skip
    shape = "(2, M, 3): wi, then wo" if len(names) == 2 else "(M, 3)"
    content = {
        "application/json": {"schema": schema, "example": {name: _EXAMPLES[name] for name in names}},
        NPY: {"schema": {**_BINARY, "description": f"float64 or float32, {shape}"}},
        ARROW: {"schema": {**_BINARY, "description": f"columns {', '.join(names)}: lists of three numbers"}},
    }
    return {"requestBody": {"required": True, "content": content}}


def array_response(kind: type[BaseModel]) -> dict[int | str, dict[str, Any]]:
    """The 200 answer: JSON of that schema, ``.npy`` or an Arrow stream."""
    content = {NPY: {"schema": _BINARY}, ARROW: {"schema": _BINARY}}
    about = "As JSON, or `.npy` or an Arrow stream where Accept prefers that"
    return {200: {"model": kind, "description": about, "content": content}}


def upload_request() -> dict[str, Any]:
    """The body of an upload: the bytes themselves, or a form."""
    fields = {"file": _BINARY}
    form = {"type": "object", "required": ["file"], "properties": fields, "additionalProperties": False}
    content = {
        "application/octet-stream": {"schema": _BINARY},
        "text/plain": {"schema": {"type": "string"}, "example": _TABLE},
        "multipart/form-data": {"schema": form},
    }  # fmt: skip
    return {"requestBody": {"required": True, "content": content}}


def _conditional(operation: dict[str, Any]) -> None:
    """Add what api.conditional does to an operation: the tag, and the answer to who has it."""
    answer = operation["responses"]["200"]
    if "text/event-stream" in answer.get("content", {}):
        return
    tag = {"description": "hash of the content", "schema": {"type": "string"}}
    answer.setdefault("headers", {})["ETag"] = tag
    operation["responses"]["304"] = {"description": "The content is what If-None-Match names"}


def _guarded(operation: dict[str, Any], scope: str) -> None:
    """Add what api.guard does to an operation: the key, and the answers to who has none or asks too often."""
    # Either: whether keys are asked for is the server's affair.
    operation["security"] = [{"key": [scope]}, {}]
    for status, says in (
        ("401", "This server asks for an API key"), ("403", "The key does not have the scope"),
        ("429", "Too many requests, or too many jobs wait"), ("503", "The database is away for a while"),
        *([("507", "The disk is full")] if scope == "write" else []),
    ):  # fmt: skip
        operation["responses"].setdefault(status, {"description": says})


def _idempotent(operation: dict[str, Any]) -> None:
    """Add what api.idempotency does to an operation."""
    about = "any text: the same request again under this name gets the first one's answer"
    operation["parameters"].append(_header("Idempotency-Key", about, maxLength=255))
    operation["responses"].setdefault("409", {"description": "That request is being worked on"})


def _header(name: str, about: str, **schema: Any) -> dict[str, Any]:
    return {
        "name": name, "in": "header", "required": False, "description": about,
        "schema": {"type": "string", **schema},
    }  # fmt: skip


def _completed(made: dict[str, Any]) -> None:
    """What middleware does to operations, problems as media type, examples of ids."""
    made["components"]["securitySchemes"] = {"key": {"type": "http", "scheme": "bearer"}}
    for path, operations in made["paths"].items():
        for method, operation in operations.items():
            operation.setdefault("parameters", [])
            if method == "get" and path.startswith("/v1/"):
                _conditional(operation)
            if not is_open(path):
                scope = needed(method.upper(), path)
                _guarded(operation, scope)
                if method == "post" and scope == "write":
                    _idempotent(operation)
            if JSON in operation.get("requestBody", {}).get("content", {}):
                operation["responses"]["415"] = {"description": "The body is of another type"}
            for status, answer in operation["responses"].items():
                if int(status) >= 400:
                    answer["content"] = {MEDIA_TYPE: {"schema": _PROBLEM}}
            for parameter in operation["parameters"]:
                if parameter["name"] in _PARAMETERS:
                    parameter.setdefault("example", _PARAMETERS[parameter["name"]])


def install(app: FastAPI, answers: Mapping[str, Any]) -> None:
    """Make the application's schema say what the framework can't know.

    answers : examples by path of what operations answer that take nothing that an example could show.
    """

    def schema() -> dict[str, Any]:
        if app.openapi_schema is None:
            made = get_openapi(
                title=app.title, version=app.version, summary=app.summary, description=app.description,
                routes=app.routes,
            )  # fmt: skip
            _completed(made)
            # The framework would leave out what is null.
            for path, example in answers.items():
                (content,) = made["paths"][path]["get"]["responses"]["200"]["content"].values()
                content["example"] = example
            app.openapi_schema = made
        return app.openapi_schema

    app.openapi = schema  # type: ignore[method-assign]
