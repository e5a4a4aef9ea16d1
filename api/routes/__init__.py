"""Routes: one file per noun."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query

from api.problems import ProblemDocument

Limit = Annotated[int, Query(ge=1, le=200, description="rows at most")]
Offset = Annotated[int, Query(ge=0, le=2**31 - 1, description="rows to leave out, newest first")]

_SAYS = {
    400: "The request can't be understood",
    404: "There is no such thing",
    409: "Its state does not allow that",
    413: "The request is too large",
    422: "The request is understood and can't be carried out",
    429: "Too many jobs wait",
    500: "The server failed",
    503: "The server is not ready",
}


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """The ``responses`` of a route that may answer with these problems (and 500)."""
    return {status: {"model": ProblemDocument, "description": _SAYS[status]} for status in (*statuses, 500)}
