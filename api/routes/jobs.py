"""Jobs: list, look at, follow, cancel."""

from __future__ import annotations

from collections.abc import AsyncIterable
from typing import Annotated, Any, Literal

import anyio
from anyio import to_thread
from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.sse import EventSourceResponse, ServerSentEvent

from api import documents, schemas
from api.access import Here
from api.problems import Problem
from api.routes import Limit, Offset, OfTable, page, problems
from api.rows import JobRow
from api.states import DONE, FAILED, FINAL

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

#: Seconds between two looks at the row that is followed.
LOOK_EVERY = 0.25
State = Literal["queued", "running", "done", "failed", "cancelled"]


def _row(id: str, here: Here) -> JobRow:
    return here.get(JobRow, id)


Job = Annotated[JobRow, Depends(_row)]


@router.get("", response_model=schemas.Page[schemas.JobDocument], responses=problems(422))
def jobs(
    request: Request, response: Response, here: Here, limit: Limit = 50, offset: Offset = 0,
    state: Annotated[State | None, Query()] = None, table: OfTable = None,
) -> dict[str, Any]:  # fmt: skip
    """The jobs, newest first."""
    where = [] if state is None else [JobRow.state == state]
    if table is not None:
        where.append(JobRow.table_id == table)
    rows, total = here.page(JobRow, limit, offset, *where)
    return page(request, response, [documents.job(row) for row in rows], total, limit, offset)


@router.get("/{id}", response_model=schemas.JobDocument, responses=problems(404, 422))
def job(row: Job) -> dict[str, Any]:
    """State, progress, and links to what the job made."""
    return documents.job(row)


@router.get("/{id}/events", response_class=EventSourceResponse, responses=problems(404, 422))
async def events(
    row: Job,
    here: Here,
    last_event_id: Annotated[
        int, Header(ge=0, le=2**31 - 1, description="the last event received: go on after it")
    ] = 0,
) -> AsyncIterable[ServerSentEvent]:
    """Follow a job: a `progress` event at each change, then one named for the final state; both hold the job.

    Events are numbered from 1 and kept: a client that connects again with `Last-Event-ID` misses none and
    gets none twice. The stream ends with the final event, or when the server stops.
    """
    seen = last_event_id
    while not here.service.stopping.is_set():
        found = await to_thread.run_sync(here.service.store.events, row.id, seen)
        for event in found:
            yield ServerSentEvent(data=documents.job_event(row, event), event=event.kind, id=str(event.seq))
            seen = event.seq
            if event.kind in FINAL:
                return
        if found:
            continue
        current = await to_thread.run_sync(here.service.store.get, JobRow, row.id)
        if current is None or (current.state in FINAL and seen >= current.events):
            return
        await anyio.sleep(LOOK_EVERY)


@router.post(
    "/{id}/cancel", status_code=202, response_model=schemas.JobDocument, responses=problems(404, 409, 422)
)
def cancel(row: Job, here: Here) -> dict[str, Any]:
    """Cancel a job: at once while it waits, at its next safe point while it runs."""
    now = here.service.store.cancel(row.id)
    if now.state in (DONE, FAILED):
        raise Problem(409, "job-finished", f"the job is {now.state} already")
    return documents.job(now)
