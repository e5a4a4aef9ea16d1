"""Receiving: bytes on their way into the blobs, a piece at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from anyio import CancelScope, to_thread
from fastapi import Request

from api.blobs import Blobs, Incoming

#: Bytes that are hashed and written at a time.
CHUNK = 1 << 20


async def receive(request: Request, sink: Callable[[bytes], None]) -> None:
    """The body, to ``sink`` in pieces, in a thread: it hashes and writes one while the next arrives."""
    waiting: list[bytes] = []
    size = 0
    at_work: asyncio.Task[None] | None = None
    try:
        async for chunk in request.stream():
            waiting.append(chunk)
            size += len(chunk)
            if size >= CHUNK:
                if at_work is not None:
                    await asyncio.shield(at_work)
                at_work = asyncio.create_task(to_thread.run_sync(sink, b"".join(waiting)))
                waiting, size = [], 0
    finally:
        # Whatever happened: nobody closes the file while it is written to.
        if at_work is not None:
            with CancelScope(shield=True):
                await at_work
    if size:
        await to_thread.run_sync(sink, b"".join(waiting))


def copy(blobs: Blobs, sha256: str, incoming: Incoming) -> None:
    """A blob's bytes once more, as if they had been uploaded. Raises OSError where they are others by now."""
    with blobs.open(sha256) as file:
        while piece := file.read(CHUNK):
            incoming.write(piece)
    if incoming.finish() != sha256:
        raise OSError(f"the kept file {sha256} is damaged")
