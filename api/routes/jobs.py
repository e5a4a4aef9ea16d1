"""Jobs: list, look at, follow, cancel."""

from __future__ import annotations

from collections.abc import AsyncIterable
from typing import Annotated, Any, Literal

import anyio
from anyio import to_thread
from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.sse import EventSourceResponse, ServerSentEvent

from api import documents, schemas
from api.problems import Problem
from api.routes import Limit, Offset, page, problems
from api.rows import DONE, FAILED, FINAL, JobRow
from api.service import Here

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

#: Seconds between two looks at the row that is followed.
LOOK_EVERY = 0.25
State = Literal["queued", "running", "done", "failed", "cancelled"]


def _row(id: str, here: Here) -> JobRow:
    row = here.store.get(JobRow, id)
    if row is None:
        raise Problem.not_found("job", id)
    return row


Job = Annotated[JobRow, Depends(_row)]


@router.get("", response_model=schemas.Page[schemas.JobDocument], responses=problems(422))
def jobs(
    request: Request, response: Response, here: Here, limit: Limit = 50, offset: Offset = 0,
    state: Annotated[State | None, Query()] = None,
) -> dict[str, Any]:  # fmt: skip
    """The jobs, newest first."""
    where = () if state is None else (JobRow.state == state,)
    rows, total = here.store.page(JobRow, limit, offset, *where)
    return page(request, response, [documents.job(row) for row in rows], total, limit, offset)


@router.get("/{id}", response_model=schemas.JobDocument, responses=problems(404, 422))
def job(row: Job) -> dict[str, Any]:
    """State, progress, and links to what the job made."""
    return documents.job(row)


@router.get("/{id}/events", response_class=EventSourceResponse, responses=problems(404, 422))
async def events(row: Job, here: Here) -> AsyncIterable[ServerSentEvent]:
    """Follow a job: a `progress` event at each change, then one named for the final state; both hold the job.

    The stream also ends when the server stops; a client that connects again goes on where the job is.
    """
    shown = None
    current: JobRow | None = row
    while current is not None and not here.stopping.is_set():
        document = documents.job(current)
        final = current.state in FINAL
        if document != shown:
            yield ServerSentEvent(data=document, event=current.state if final else "progress")
            shown = document
        if final:
            return
        await anyio.sleep(LOOK_EVERY)
        current = await to_thread.run_sync(here.store.get, JobRow, row.id)


@router.post(
    "/{id}/cancel", status_code=202, response_model=schemas.JobDocument, responses=problems(404, 409, 422)
)
def cancel(row: Job, here: Here) -> dict[str, Any]:
    """Cancel a job: at once while it waits, at its next safe point while it runs."""
    now = here.store.cancel(row.id)
    if now.state in (DONE, FAILED):
        raise Problem(409, "job-finished", f"the job is {now.state} already")
    return documents.job(now)
