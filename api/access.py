"""Access: the service as one caller sees it. Routes work with this: none can forget whose rows are whose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

from fastapi import Depends, Request
from sqlalchemy import ColumnElement

from api.idempotency import Fingerprint
from api.keys import Caller
from api.problems import Problem
from api.rows import Row
from api.service import Service
from api.sessions import new_id

_R = TypeVar("_R", bound=Row)


@dataclass(frozen=True)
class Mine:
    """What a caller may see and make.

    made : the id of what a request makes that named itself (Idempotency-Key); None for others.
    fingerprint : of such a request.
    """

    service: Service
    caller: Caller
    made: str | None = None
    fingerprint: Fingerprint | None = None

    def sees(self, owner: str) -> bool:
        """Whether that owner's rows are there for the caller."""
        return self.caller.sees_all or owner == self.caller.owner

    def find(self, kind: type[_R], id: str) -> _R | None:
        """The row, None where there is none or it is another owner's."""
        row = self.service.store.get(kind, id)
        return row if row is not None and self.sees(row.owner) else None

    def get(self, kind: type[_R], id: str, noun: str | None = None) -> _R:
        """The row. Raises Problem (404)."""
        row = self.find(kind, id)
        if row is None:
            raise Problem.not_found(noun or kind.__tablename__.removesuffix("s"), id)
        return row

    def page(
        self, kind: type[_R], limit: int, offset: int, *where: ColumnElement[bool]
    ) -> tuple[Sequence[_R], int]:
        """Rows, newest first, and how many there are in all."""
        whose = () if self.caller.sees_all else (kind.owner == self.caller.owner,)
        return self.service.store.page(kind, limit, offset, *whose, *where)

    def drawn(self, kind: type[_R], id: str, suffix: str) -> bytes:
        """What was drawn of a result before its row was published: "png", say. Raises Problem (404)."""
        content = self.service.results.report(self.get(kind, id).id, suffix)
        assert content is not None
        return content

    def new_id(self) -> str:
        """The id of what this request makes."""
        return self.made or new_id()

    def made_before(self, kind: type[_R]) -> _R | None:
        """What an earlier attempt at this request made before it was cut off."""
        return None if self.made is None else self.find(kind, self.made)


async def of_request(request: Request) -> Mine:
    """The service as whoever sent the request sees it. It waits for nothing, so it needs no thread."""
    state = request.state
    return Mine(
        request.app.state.service, getattr(state, "caller", Caller()), getattr(state, "made", None),
        getattr(state, "fingerprint", None),
    )  # fmt: skip


Here = Annotated[Mine, Depends(of_request)]
