"""Starting jobs: queue one, and wait for its end as long as the client prefers (RFC 7240)."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Annotated, Any

import anyio
from anyio import to_thread
from fastapi import Header, Response

from api import documents, schemas
from api.access import Mine
from api.routes import problems
from api.rows import JobRow, TableRow
from api.states import FINAL

#: Seconds that a request waits at most, whatever it prefers: proxies give up after a minute.
LONGEST_WAIT = 60
#: Seconds between two looks at the row that is waited for: first and last.
LOOK_EVERY = (0.02, 0.25)
_WAIT = re.compile(r"(?:^|[,;\s])wait\s*=\s*\"?(\d{1,6})\b", re.IGNORECASE)

Prefer = Annotated[
    str | None,
    Header(description="`wait=N`: answer 200 once the job has ended, where that takes N seconds at most",
           examples=["wait=10"]),
]  # fmt: skip


def answers(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """The ``responses`` of a route that starts a job."""
    ended = {"model": schemas.JobDocument, "description": "The job, which has ended (Prefer: wait=N)"}
    return {200: ended, **problems(*statuses)}


async def started(
    here: Mine, response: Response, prefer: str | None, kind: str,
    prepare: Callable[[], tuple[str | None, dict[str, Any]]],
) -> dict[str, Any]:  # fmt: skip
    """Queue a job; the answer that shows it.

    ``prepare`` : runs in a thread; the id of the table that the job works on, if any, and its request.

    Raises Problem (404, 429) and what ``prepare`` raises.
    """
    job = await to_thread.run_sync(_queue, here, kind, prepare)
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    asked = _WAIT.search(prefer or "")
    if asked is not None:
        seconds = min(int(asked[1]), LONGEST_WAIT)
        response.headers["Preference-Applied"] = f"wait={seconds}"
        job = await _ended(here, job, seconds)
        if job.state in FINAL:
            response.status_code = 200
    return documents.job(job)


def _queue(here: Mine, kind: str, prepare: Callable[[], tuple[str | None, dict[str, Any]]]) -> JobRow:
    before = here.made_before(JobRow)
    if before is not None:
        return before
    table, request = prepare()
    if table is not None:
        here.get(TableRow, table)
    job = JobRow(
        id=here.new_id(), created=time.time(), owner=here.caller.owner, kind=kind, table_id=table or "",
        request=request,
    )  # fmt: skip
    here.service.submit(job)
    return job


async def _ended(here: Mine, job: JobRow, seconds: float) -> JobRow:
    """The job as it is once it has ended, the time is over or the server stops."""
    end, pause = anyio.current_time() + seconds, LOOK_EVERY[0]
    while job.state not in FINAL and anyio.current_time() < end and not here.service.stopping.is_set():
        await anyio.sleep(pause)
        pause = min(2 * pause, LOOK_EVERY[1])
        job = await to_thread.run_sync(here.service.store.get, JobRow, job.id) or job
    return job
