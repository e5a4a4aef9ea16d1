"""Problems: every error as an RFC 9457 document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any

import orjson
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import BaseRoute, Match
from starlette.types import Scope

from fitter.errors import FitterError

MEDIA_TYPE = "application/problem+json"
JSON = "application/json"
_OWN = ("status", "code", "detail")


class ProblemDocument(BaseModel):
    """RFC 9457: what happened, where, the likely cause and the remedy. ``code`` is stable."""

    model_config = ConfigDict(
        extra="allow",
        json_schema_extra={
            "example": {
                "type": "/problems/not-found", "title": "Not Found", "status": 404, "code": "not-found",
                "detail": "there is no table 0123456789abcdef0123456789abcdef",
                "instance": "/v1/tables/0123456789abcdef0123456789abcdef",
            }
        },
    )  # fmt: skip

    type: str = Field(description="`/problems/` and the code")
    title: str
    status: int
    code: str
    detail: str
    instance: str | None = None
    file: str | None = None
    row: int | None = None
    column: str | None = None
    parameter: str | None = None
    cause: str | None = None
    remedy: str | None = None


class Problem(HTTPException):
    """An error of the service itself. ``more`` are further members of the document.

    An HTTPException, because the framework lets only those pass unchanged out of its body parsing.
    """

    def __init__(
        self, status: int, code: str, detail: str, *, headers: Mapping[str, str] | None = None, **more: Any
    ) -> None:
        super().__init__(status, detail, dict(headers) if headers else None)
        self.code = code
        self.more = {key: item for key, item in more.items() if item is not None}

    @classmethod
    def not_found(cls, noun: str, id: str) -> Problem:
        return cls(404, "not-found", f"there is no {noun} {id[:64]}")

    @classmethod
    def of_document(cls, found: Mapping[str, Any]) -> Problem:
        """The problem that a document tells of."""
        more = {key: item for key, item in found.items() if key not in ("type", "title", *_OWN)}
        status, code, detail = (found[key] for key in _OWN)
        return cls(status, code, detail, **more)

    @classmethod
    def too_large(cls, limit: int) -> Problem:
        return cls(
            413, "too-large", f"the request is larger than the limit of {limit} bytes",
            remedy="send less, or have the server's operator raise the limit",
        )  # fmt: skip

    @classmethod
    def unsupported(cls, content_type: str, taken: Sequence[str]) -> Problem:
        return cls(
            415, "unsupported-media-type", f"the body's content type is {content_type[:64] or 'not named'}",
            parameter="Content-Type", remedy=f"send it as {' or '.join(taken)}",
        )  # fmt: skip

    @classmethod
    def invalid(cls, code: str, detail: str, **more: Any) -> Problem:
        return cls(422, code, detail, **more)


def document(status: int, code: str, detail: str, **more: Any) -> dict[str, Any]:
    """The problem document."""
    return {
        "type": f"/problems/{code}", "title": HTTPStatus(status).phrase, "status": status, "code": code,
        "detail": detail, **more,
    }  # fmt: skip


def of_fitter_error(error: FitterError) -> dict[str, Any]:
    """The document of a library error: the input was understood and can't be worked with (422)."""
    fields = error.to_dict()
    code, message = str(fields.pop("code")), str(fields.pop("message"))
    return document(422, code, message, **fields)


def internal() -> dict[str, Any]:
    """The document of an error nobody foresaw. The traceback goes to the log, never to the client."""
    return document(
        500, "internal-error", "the server failed in a way its authors did not foresee",
        remedy="report it, with the request's id, to the server's operator",
    )  # fmt: skip


def install(app: FastAPI) -> None:
    """Make the application answer every error with a problem document."""

    async def on_http(request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        if isinstance(error, Problem):
            found = document(error.status_code, error.code, error.detail, **error.more)
        else:
            code = HTTPStatus(error.status_code).phrase.lower().replace(" ", "-")
            found = document(error.status_code, code, str(error.detail))
        headers = dict(error.headers or {})
        if error.status_code == 405:
            # The application does not list what is below a mount: files.
            headers["Allow"] = ", ".join(_methods(request.scope)) or "GET, HEAD"
        return respond(found, request.scope, headers)

    async def on_validation(request: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)
        first, kind = error.errors()[0], media_type(request)
        if first["loc"] == ("body",) and first["type"] != "missing" and not is_json(kind):
            # The framework takes a body that is not said to be JSON for a text.
            return answer(Problem.unsupported(kind, [JSON]), request.scope)
        return respond(_of_validation(error.errors()), request.scope)

    async def on_fitter(request: Request, error: Exception) -> Response:
        assert isinstance(error, FitterError)
        return respond(of_fitter_error(error), request.scope)

    async def on_disconnect(request: Request, error: Exception) -> Response:
        # Nobody is left to read it, but the access log should not call it a server error.
        gone = document(400, "client-gone", "the client closed the connection")
        return respond(gone, request.scope)

    app.add_exception_handler(HTTPException, on_http)
    app.add_exception_handler(RequestValidationError, on_validation)
    app.add_exception_handler(FitterError, on_fitter)
    app.add_exception_handler(ClientDisconnect, on_disconnect)


def media_type(request: Request) -> str:
    """Of the request's body, without its parameters; "" where none is named."""
    return request.headers.get("content-type", "").split(";")[0].strip().lower()


def is_json(kind: str) -> bool:
    return kind == JSON or (kind.startswith("application/") and kind.endswith("+json"))


def _methods(scope: Scope) -> list[str]:
    """What may be done at a path. The framework names the methods only of the first route that has it."""
    routes: Sequence[BaseRoute] = scope["app"].routes
    found = [
        method for method in ("GET", "POST", "DELETE")
        if any(route.matches({**scope, "method": method})[0] is Match.FULL for route in routes)
    ]  # fmt: skip
    return [*found, "HEAD"] if "GET" in found else found


def _of_validation(errors: Sequence[Any]) -> dict[str, Any]:
    listed = [{"location": ".".join(str(part) for part in e["loc"]), "message": e["msg"]} for e in errors]
    first = errors[0]
    if first["type"] == "json_invalid":
        return document(400, "bad-json", f"the body is not JSON: {first.get('ctx', {}).get('error', '')}")
    where = [str(part) for part in first["loc"]]
    message = str(first["msg"]).removeprefix("Value error, ")
    return document(
        422, "bad-request", message, parameter=".".join(where[1:]) or where[0], errors=listed,
        remedy="see /docs for what this operation takes",
    )  # fmt: skip


def answer(problem: Problem, scope: Scope) -> Response:
    """The answer that a problem is, for middleware: the framework knows nothing of it there."""
    found = document(problem.status_code, problem.code, problem.detail, **problem.more)
    return respond(found, scope, problem.headers)


def respond(found: dict[str, Any], scope: Scope, headers: Mapping[str, str] | None = None) -> Response:
    """The answer that holds a problem document; it is counted."""
    scope["app"].state.service.metrics.problem(found["code"])
    content = encoded({**found, "instance": scope["path"]})
    return Response(content, found["status"], headers=headers, media_type=MEDIA_TYPE)


def encoded(found: Mapping[str, Any]) -> bytes:
    """JSON bytes of a document that may quote text a client sent, lone surrogates included."""
    return orjson.dumps(_printable(found), option=orjson.OPT_SERIALIZE_NUMPY)


def _printable(item: Any) -> Any:
    if isinstance(item, str):
        return item.encode("utf-8", "replace").decode()
    if isinstance(item, Mapping):
        return {_printable(str(key)): _printable(value) for key, value in item.items()}
    if isinstance(item, list | tuple):
        return [_printable(value) for value in item]
    return item
