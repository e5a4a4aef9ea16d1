"""Idempotency: a POST that names itself (``Idempotency-Key``) makes what it makes once.

The name is claimed in the database before the work begins, together with the id of what will be made; so an
attempt that was cut off after it had made it, by a crash or on the wire, is found out by the next. Answers
are kept for a day. Names belong to their owner: nobody learns what others use.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from anyio import CancelScope, CapacityLimiter, to_thread
from sqlalchemy import delete, select, update
from sqlalchemy.exc import IntegrityError
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.guard import needed
from api.keys import Caller
from api.outages import DATABASE
from api.problems import Problem, answer
from api.rows import IdempotencyRow
from api.sessions import Now, Sessions, new_id

_log = logging.getLogger("brdf_fitter.api")

#: Seconds that an answer is kept.
KEPT = 86_400.0
#: Seconds after which a request whose claim is not renewed counts as cut off with its server.
LEASE = 30.0
#: Headers of an answer that are part of it.
_HEADERS = ("content-type", "location", "preference-applied")


@dataclass(frozen=True)
class Kept:
    """An answer from before."""

    fingerprint: str
    status: int
    headers: Mapping[str, str]
    body: bytes


def claim(store: Sessions, owner: str, key: str) -> str | Kept | None:
    """The id for what the request makes where it is to be worked on, the answer where there is one, None
    where somebody else works on it."""
    try:
        return _claim(store, owner, key)
    except IntegrityError:  # two at once: the other was first
        return _claim(store, owner, key)


def _claim(store: Sessions, owner: str, key: str) -> str | Kept | None:
    with store.writing() as session:
        session.execute(delete(IdempotencyRow).where(IdempotencyRow.created < time.time() - KEPT))
        now = session.scalar(select(Now())) or 0.0
        row = session.get(IdempotencyRow, (owner, key), with_for_update=True)
        if row is None:
            row = IdempotencyRow(
                owner=owner, key=key, created=time.time(), made=new_id(), lease=now + LEASE
            )  # fmt: skip
            session.add(row)
        elif row.status is not None:
            return Kept(row.fingerprint or "", row.status, row.headers or {}, row.body or b"")
        elif row.lease >= now:
            return None
        else:
            row.lease = now + LEASE
        return row.made


def renew(store: Sessions, owner: str, key: str) -> None:
    """Whoever works on the request is still at it."""
    with store.writing() as session:
        session.execute(
            update(IdempotencyRow)
            .where(IdempotencyRow.owner == owner, IdempotencyRow.key == key, IdempotencyRow.status.is_(None))
            .values(lease=Now() + LEASE)
        )


def keep(store: Sessions, owner: str, key: str, kept: Kept) -> None:
    """The request is answered."""
    with store.writing() as session:
        session.execute(
            update(IdempotencyRow).where(IdempotencyRow.owner == owner, IdempotencyRow.key == key)
            .values(
                fingerprint=kept.fingerprint, status=kept.status, headers=dict(kept.headers), body=kept.body
            )
        )  # fmt: skip


def release(store: Sessions, owner: str, key: str, *, forget: bool) -> None:
    """The request came to nothing: forget it, or let its next attempt go on with the same id."""
    mine = (IdempotencyRow.owner == owner, IdempotencyRow.key == key, IdempotencyRow.status.is_(None))
    with store.writing() as session:
        session.execute(
            delete(IdempotencyRow).where(*mine) if forget
            else update(IdempotencyRow).where(*mine).values(lease=0.0)
        )  # fmt: skip


class Idempotent:
    """Middleware for POSTs that make something."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        # Not of the threads that requests share: those may all be at work for longer than a claim lasts.
        self._threads = CapacityLimiter(1)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        key = Headers(scope=scope).get("idempotency-key") if scope["type"] == "http" else None
        if key is None or scope["method"] != "POST" or needed("POST", scope["path"]) == "read":
            await self._app(scope, receive, send)
            return
        store: Sessions = scope["app"].state.service.store
        caller: Caller = scope["state"]["caller"]
        body = Fingerprint(scope, receive)
        try:
            if not 1 <= len(key) <= 255 or not key.isprintable():
                raise Problem.invalid(
                    "bad-idempotency-key", "the Idempotency-Key is empty, too long or unprintable",
                    parameter="Idempotency-Key", remedy="give a text of 1 to 255 characters, as a UUID",
                )  # fmt: skip
            found = await to_thread.run_sync(claim, store, caller.owner, key)
            if found is None:
                raise Problem(
                    409, "in-flight", "a request with this Idempotency-Key is being worked on",
                    headers={"Retry-After": "1"}, remedy="ask again in a moment",
                )  # fmt: skip
            if isinstance(found, Kept) and await body.whole() != found.fingerprint:
                raise Problem.invalid(
                    "idempotency-key-reused", "this Idempotency-Key was used for another request",
                    parameter="Idempotency-Key", remedy="give each request a key of its own",
                )  # fmt: skip
        except Problem as problem:
            await answer(problem, scope)(scope, receive, send)
            return
        except ClientDisconnect:
            return
        if isinstance(found, Kept):
            await _replay(found, send)
            return
        scope["state"].update(made=found, fingerprint=body)
        await self._work(store, caller.owner, key, body, scope, send)

    async def _work(
        self, store: Sessions, owner: str, key: str, body: Fingerprint, scope: Scope, send: Send
    ) -> None:
        """Let the request be answered, and keep the answer before it is sent."""
        start: Message | None = None
        content = bytearray()
        done = False

        async def kept(message: Message) -> None:
            nonlocal start, done
            if message["type"] == "http.response.start":
                start = message
                return
            assert start is not None
            content.extend(message.get("body", b""))
            if message.get("more_body", False):
                return
            done = True
            if 200 <= start["status"] < 300:
                headers = Headers(raw=start["headers"])
                shown = {name: headers[name] for name in _HEADERS if name in headers}
                answered = Kept(await body.whole(), start["status"], shown, bytes(content))
                await to_thread.run_sync(keep, store, owner, key, answered)
            else:
                await to_thread.run_sync(
                    lambda: release(store, owner, key, forget=start is not None and start["status"] < 500)
                )
            await send(start)
            await send({**message, "body": bytes(content)})

        renewing = asyncio.create_task(_renewing(store, owner, key, self._threads))
        try:
            await self._app(scope, body.receive, kept)
        finally:
            renewing.cancel()
            if not done:
                with CancelScope(shield=True):
                    # A renewal that is under way would come after the release, and take it back.
                    await asyncio.wait([renewing])
                    await _released(store, owner, key)


async def _renewing(store: Sessions, owner: str, key: str, threads: CapacityLimiter) -> None:
    while True:
        await asyncio.sleep(LEASE / 3)
        # Where the database is away, the next time may do.
        with contextlib.suppress(*DATABASE):
            await to_thread.run_sync(renew, store, owner, key, limiter=threads)


async def _released(store: Sessions, owner: str, key: str) -> None:
    """Let the next attempt go on; where the database does not take that, the claim lapses by itself. What cut
    this one off is the error to tell."""
    try:
        await to_thread.run_sync(lambda: release(store, owner, key, forget=False))
    except DATABASE as error:
        _log.warning("an Idempotency-Key can't be released, and is in %g s: %s", LEASE, error)


class Fingerprint:
    """What tells a request from others: a hash of where it goes, and of its body as it passes.

    body : its sha256 where somebody else hashes it, which :meth:`leave` says.
    """

    def __init__(self, scope: Scope, receive: Receive) -> None:
        self.body: str | None = None
        self._receive = receive
        self._ended = False
        self._digest: Any = hashlib.sha256()
        headers = Headers(scope=scope)
        self._head = "".join(
            f"{len(part)}:{part}" for part in
            (scope["path"], scope["query_string"].decode("latin-1"), headers.get("content-type", ""))
        )  # fmt: skip

    def leave(self) -> None:
        """Whoever reads the body sets ``body`` to its hash, once it has come."""
        self._digest = None

    async def receive(self) -> Message:
        message = await self._receive()
        if message["type"] == "http.request":
            if self._digest is not None:
                self._digest.update(message.get("body", b""))
            self._ended = not message.get("more_body", False)
        return message

    async def whole(self) -> str:
        """Read what nobody has read yet; the fingerprint. Raises ClientDisconnect."""
        while not self._ended:
            if (await self.receive())["type"] == "http.disconnect":
                raise ClientDisconnect
        body = self.body if self._digest is None else self._digest.hexdigest()
        assert body is not None
        return hashlib.sha256(f"{self._head}{body}".encode()).hexdigest()


async def _replay(found: Kept, send: Send) -> None:
    headers = [(name.encode("latin-1"), value.encode("latin-1")) for name, value in found.headers.items()]
    headers += [(b"content-length", str(len(found.body)).encode()), (b"idempotency-replayed", b"true")]
    await send({"type": "http.response.start", "status": found.status, "headers": headers})
    await send({"type": "http.response.body", "body": found.body})


def reset(store: Sessions) -> None:
    """What a dead server was at may be taken up at once. Only for a database's one server, at start."""
    with store.writing() as session:
        session.execute(update(IdempotencyRow).where(IdempotencyRow.status.is_(None)).values(lease=0.0))
