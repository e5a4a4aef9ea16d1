"""Routes: one file per noun."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import Query, Request, Response

from api.problems import ProblemDocument

Limit = Annotated[int, Query(ge=1, le=200, description="rows at most")]
OfTable = Annotated[str | None, Query(max_length=64, description="id: only what was made of this table")]
Offset = Annotated[int, Query(ge=0, le=2**31 - 1, description="rows to leave out, newest first")]


def page(
    request: Request, response: Response, items: Sequence[dict[str, Any]], total: int, limit: int, offset: int
) -> dict[str, Any]:
    """Part of a list, and the header Link to its other parts (RFC 8288)."""
    first = offset % limit
    last = first + limit * max((total - 1 - first) // limit, 0)
    targets = {"first": 0, "prev": max(offset - limit, 0), "next": offset + limit, "last": last}
    if offset == 0:
        del targets["prev"]
    if offset + limit >= total:
        del targets["next"]
    kept = [(name, value) for name, value in request.query_params.multi_items()
            if name not in ("limit", "offset")]  # fmt: skip
    links = [
        f'<{request.url.path}?{urlencode([*kept, ("limit", limit), ("offset", start)])}>; rel="{relation}"'
        for relation, start in targets.items()
    ]
    response.headers["Link"] = ", ".join(links)
    return {"items": list(items), "total": total, "limit": limit, "offset": offset}


_SAYS = {
    400: "The request can't be understood",
    404: "There is no such thing",
    409: "Its state does not allow that",
    413: "The request is too large",
    416: "The range begins beyond the end",
    422: "The request is understood and can't be carried out",
    429: "Too many jobs wait",
    500: "The server failed",
    503: "The server is not ready",
}


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """The ``responses`` of a route that may answer with these problems (and 500)."""
    return {status: {"model": ProblemDocument, "description": _SAYS[status]} for status in (*statuses, 500)}
