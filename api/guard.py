"""Guard: who asks, whether they may, and how often; before anything of a request's body is read."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from anyio import to_thread
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api import keys, logs
from api.keys import Caller
from api.problems import Problem, answer
from api.rates import Rates
from api.settings import Settings

if TYPE_CHECKING:
    from api.service import Service

#: What needs no key: whether the server is there, and how to use it.
_OPEN = re.compile(r"/|/healthz|/readyz|/docs|/openapi\.json|/docs-assets/.*|/page/.*")
#: POSTs that change nothing.
_ASKING = re.compile(r"/v1/(?:models|tables)/[^/]+/(?:evaluate|pdf|albedo|samples?)|/v1/scenes/plan")


def is_open(path: str) -> bool:
    """Whether an operation needs no key."""
    return _OPEN.fullmatch(path) is not None


def needed(method: str, path: str) -> keys.Scope:
    """The scope that an operation needs."""
    if path == "/metrics":
        return "admin"
    if method in ("GET", "HEAD", "OPTIONS") or (method == "POST" and _ASKING.fullmatch(path)):
        return "read"
    return "write"


class Guard:
    """Middleware: 401 without a good key, 403 without the scope, 429 where somebody asks too often."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._settings = settings
        self._rates = Rates(settings.requests_per_second, settings.burst)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or is_open(scope["path"]):
            await self._app(scope, receive, send)
            return
        caller = Caller()
        try:
            if self._settings.keys:
                caller = await self._caller(scope)
            scope.setdefault("state", {})["caller"] = caller
            if caller.key is not None:
                logs.naming(key=caller.key)
            taken = self._rates.take(caller.key or _address(scope))
            if taken is not None and taken.retry_after:
                raise Problem(
                    429, "too-many-requests", f"more than {self._rates.words} were asked for",
                    headers={"Retry-After": str(taken.retry_after), **taken.headers},
                    remedy=f"wait {taken.retry_after} s",
                )  # fmt: skip
            if not caller.may(wanted := needed(scope["method"], scope["path"])):
                raise Problem(
                    403, "scope-missing", f"this needs a key with the scope {wanted}",
                    headers={"WWW-Authenticate": f'Bearer error="insufficient_scope", scope="{wanted}"'},
                    remedy="have the server's operator make one",
                )  # fmt: skip
        except Problem as problem:
            await answer(problem, scope)(scope, receive, send)
            return

        async def told(message: Message) -> None:
            if taken is not None and message["type"] == "http.response.start":
                headers = MutableHeaders(raw=list(message["headers"]))
                headers.update(taken.headers)
                message = {**message, "headers": headers.raw}
            await send(message)

        await self._app(scope, receive, told)

    async def _caller(self, scope: Scope) -> Caller:
        kind, _, secret = Headers(scope=scope).get("authorization", "").partition(" ")
        challenge, found = "Bearer", None
        if kind.lower() == "bearer" and secret:
            service: Service = scope["app"].state.service
            found = await to_thread.run_sync(keys.caller, service.store, secret.strip())
            challenge = 'Bearer error="invalid_token"'
        if found is None:
            raise Problem(
                401, "key-needed", "this server asks for an API key", headers={"WWW-Authenticate": challenge},
                remedy="send `Authorization: Bearer KEY`; the server's operator makes keys",
            )  # fmt: skip
        return found


def _address(scope: Scope) -> str:
    client = scope.get("client")
    return str(client[0]) if client else ""
