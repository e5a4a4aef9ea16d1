"""Observed: every request has an id, a line in the log and a place in the metrics, whatever becomes of it."""

from __future__ import annotations

import logging
import re
import time
import uuid

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api import logs
from api.keys import Caller
from api.metrics import Metrics
from api.outages import RETRY_AFTER, outage
from api.problems import internal, respond

_log = logging.getLogger("brdf_fitter.access")
_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_JOB = re.compile(r"/v1/jobs/([0-9a-f]{32})")


class Observed:
    """Middleware, the outermost: an id in and out (``X-Request-Id``), the log, the metrics, and errors that
    nobody foresaw, which the framework would answer outside of all middleware."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun = come = time.perf_counter()
        given = Headers(scope=scope).get("x-request-id", "")
        id = given if _ID.fullmatch(given) else uuid.uuid4().hex
        state = scope.setdefault("state", {})
        logs.naming(request=id)
        status, sent, job = 0, 0, _job(scope["path"])

        async def noted(message: Message) -> None:
            nonlocal status, sent, job
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(raw=list(message["headers"]))
                headers["X-Request-Id"] = id
                # All that takes time is done before an answer begins, but for streams.
                receiving, app = (f"{1e3 * t:.1f}" for t in (come - begun, time.perf_counter() - come))
                headers["Server-Timing"] = f"receive;dur={receiving}, app;dur={app}"
                job = job or _job(headers.get("location", ""))
                message = {**message, "headers": headers.raw}
            else:
                sent += len(message.get("body", b""))
            await send(message)

        async def heard() -> Message:
            nonlocal come
            message = await receive()
            if message["type"] == "http.request":
                come = time.perf_counter()
            return message

        try:
            await self._app(scope, heard, noted)
        except Exception as error:
            known = outage(error)
            if known is None:
                _log.error("%s %s failed", scope["method"], scope["path"], exc_info=error)
            else:
                _log.warning("%s %s: %s", scope["method"], scope["path"], error)
            if not status:
                headers = {} if known is None else {"Retry-After": str(RETRY_AFTER)}
                answer = respond({**(known or internal()), "request": id}, scope, headers)
                await answer(scope, receive, noted)
        seconds = time.perf_counter() - begun
        metrics: Metrics = scope["app"].state.service.metrics
        route = getattr(scope.get("route"), "path", "none")
        metrics.request(scope["method"], route, status, seconds)
        caller: Caller = state.get("caller", Caller())
        fields = {
            "method": scope["method"], "path": scope["path"], "status": status, "seconds": round(seconds, 4),
            "bytes": sent, "key": caller.key, "job": job,
        }  # fmt: skip
        _log.info("answered", extra={name: value for name, value in fields.items() if value is not None})


def _job(path: str) -> str | None:
    found = _JOB.match(path)
    return found[1] if found else None
