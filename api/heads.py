"""Heads: what a GET would answer, without its content (RFC 9110, 9.3.2); health checks ask so."""

from __future__ import annotations

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send


class Heads:
    """Middleware that lets a HEAD be answered as a GET. A stream is told that its client has gone."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
        ended = asyncio.Event()
        asked = False

        async def gone() -> Message:
            nonlocal asked
            if not asked:
                asked = True
                return {"type": "http.request", "body": b"", "more_body": False}
            await ended.wait()
            return {"type": "http.disconnect"}

        async def headed(message: Message) -> None:
            if message["type"] == "http.response.start":
                await send(message)
            elif not ended.is_set():
                ended.set()
                await send({"type": "http.response.body", "body": b"", "more_body": False})

        # A range is a GET's alone (14.2).
        headers = [(k, v) for k, v in scope["headers"] if k not in (b"range", b"if-range")]
        inner: Scope = {**scope, "method": "GET", "headers": headers}
        try:
            await self._app(inner, gone, headed)
        finally:
            scope["route"] = inner.get("route")  # for the metrics
        if not ended.is_set():  # a stream that had nothing to send
            await headed({"type": "http.response.body"})
