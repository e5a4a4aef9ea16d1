"""OpenAPI: what the framework can't know about bodies that are arrays, files or problems."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel

from api.arrow_stream import ARROW
from api.exchange import NPY
from api.problems import MEDIA_TYPE

_COMPONENT = {"type": "number", "minimum": -1.01, "maximum": 1.01}
_VECTOR = {"type": "array", "items": _COMPONENT, "minItems": 3, "maxItems": 3}
_VECTORS = {"oneOf": [_VECTOR, {"type": "array", "items": _VECTOR, "minItems": 1}]}
_EXAMPLES = {"wi": [0.6, 0.0, 0.8], "wo": [[-0.6, 0.0, 0.8], [0.0, 0.0, 1.0]]}
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
        "application/octet-stream": {"schema": _BINARY}, "text/plain": {"schema": {"type": "string"}},
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
    operation.setdefault("parameters", []).append(
        {"name": "If-None-Match", "in": "header", "required": False, "schema": {"type": "string"}}
    )


def install(app: FastAPI) -> None:
    """Make the application's schema say that every error is a problem document."""

    def schema() -> dict[str, Any]:
        if app.openapi_schema is None:
            made = get_openapi(
                title=app.title, version=app.version, summary=app.summary, description=app.description,
                routes=app.routes,
            )  # fmt: skip
            for name, path in made["paths"].items():
                for method, operation in path.items():
                    if method == "get" and name.startswith("/v1/") and "200" in operation["responses"]:
                        _conditional(operation)
                    for status, answer in operation["responses"].items():
                        if int(status) >= 400:
                            answer["content"] = {MEDIA_TYPE: {"schema": _PROBLEM}}
            app.openapi_schema = made
        return app.openapi_schema

    app.openapi = schema  # type: ignore[method-assign]
