"""Conditional requests: every whole answer to a GET has a strong ETag, and who has it already gets 304."""

from __future__ import annotations

import hashlib

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

#: Answers depend on who asks; a store of one client may keep them if it asks again each time.
PRIVATE = "private, no-cache"


def matches(if_none_match: str, tag: str) -> bool:
    """Whether a header If-None-Match names ``tag``; the comparison is the weak one (RFC 9110, 13.1.2)."""
    named = [part.strip().removeprefix("W/") for part in if_none_match.split(",")]
    return "*" in named or tag in named


class Conditional:
    """Middleware. The tag is the hash of the bytes, so it can't be out of date; streams bring theirs."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "GET" or not scope["path"].startswith("/v1/"):
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope).get("if-none-match")
        held: Message | None = None

        async def tagged(message: Message) -> None:
            nonlocal held
            if message["type"] == "http.response.start" and message["status"] == 200 and not _flows(message):
                held = message
                return
            if held is not None:
                start, held = held, None
                if not message.get("more_body", False):
                    start, message = _of_whole(start, message, given)
                await send(start)
            await send(message)

        await self._app(scope, receive, tagged)


def _flows(start: Message) -> bool:
    """Whether events follow: who waits for them is told at once that they come."""
    return Headers(raw=start["headers"]).get("content-type", "").startswith("text/event-stream")


def _of_whole(start: Message, body: Message, given: str | None) -> tuple[Message, Message]:
    """The answer with its tag, or 304 without its content."""
    headers = MutableHeaders(raw=list(start["headers"]))
    tag = f'"{hashlib.sha256(body.get("body", b"")).hexdigest()[:32]}"'
    headers["ETag"] = tag
    headers["Cache-Control"] = PRIVATE
    if given is None or not matches(given, tag):
        return {**start, "headers": headers.raw}, body
    for name in ("content-length", "content-type"):
        del headers[name]
    return {**start, "status": 304, "headers": headers.raw}, {**body, "body": b""}
