"""Contents: a table's bytes as they were uploaded, in pieces, whole or one range of them (RFC 9110, 14)."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from typing import BinaryIO

from anyio import to_thread
from fastapi import Request, Response
from fastapi.responses import StreamingResponse

from api.blobs import Blobs
from api.conditional import PRIVATE, matches
from api.problems import Problem

#: Bytes that are read and sent at a time.
PIECE = 1 << 18
_RANGE = re.compile(r"bytes\s*=\s*(\d{0,18})-(\d{0,18})", re.IGNORECASE)


async def respond_content(request: Request, blobs: Blobs, sha256: str, size: int) -> Response:
    """200, 206 or 304, whose tag is the content's own hash. Raises Problem: 416 beyond the end."""
    tag = f'"{sha256}"'
    headers = {"ETag": tag, "Cache-Control": PRIVATE, "Accept-Ranges": "bytes"}
    held = request.headers.get("if-none-match")
    if held is not None and matches(held, tag):
        return Response(status_code=304, headers=headers)
    start, stop = 0, size
    part = None
    # A range of what the client had before: of something else the whole is sent.
    if request.headers.get("if-range", tag) == tag:
        part = asked_range(request.headers.get("range", ""), size)
    if part is not None:
        start, stop = part
        headers["Content-Range"] = f"bytes {start}-{stop - 1}/{size}"
    headers |= {"Content-Length": str(stop - start), "Content-Disposition": "attachment"}
    try:
        file = await to_thread.run_sync(blobs.open, sha256)
    except FileNotFoundError as error:  # deleted since its row was read
        raise Problem(404, "not-found", "the table's bytes are gone") from error
    return StreamingResponse(
        _pieces(file, start, stop), 200 if part is None else 206, headers, "application/octet-stream"
    )


def asked_range(header: str, size: int) -> tuple[int, int] | None:
    """``(start, stop)`` of the one range that is asked for; None for no range, several, or none of bytes, for
    which the whole is sent. Raises Problem (416) where it begins beyond the end."""
    found = _RANGE.fullmatch(header.strip())
    if found is None or found[1] == found[2] == "":
        return None
    if found[1] == "":  # so many of the last bytes
        start, stop = max(0, size - int(found[2])), size
    else:
        start, stop = int(found[1]), size if found[2] == "" else min(int(found[2]) + 1, size)
        if found[2] != "" and int(found[2]) < start:
            return None
    if start >= stop:
        raise Problem(
            416, "range-beyond-end", f"the content has {size} bytes", remedy="ask for a range within it",
            headers={"Content-Range": f"bytes */{size}"},
        )  # fmt: skip
    return start, stop


async def _pieces(file: BinaryIO, start: int, stop: int) -> AsyncIterator[bytes]:
    """The bytes from ``start`` to ``stop``. Packed ones are unpacked up to there, in time but not memory."""
    try:
        at = await to_thread.run_sync(file.seek, start) if file.seekable() else 0
        while at < stop:
            piece = await to_thread.run_sync(file.read, min(PIECE, (start if at < start else stop) - at))
            if not piece:
                raise EOFError("a blob is shorter than its row says")
            if at >= start:
                yield piece
            at += len(piece)
    finally:
        file.close()  # no thread: whoever was cut off has no more turns
