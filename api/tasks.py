"""Tasks: what a worker of a Dask cluster does. It needs this package, the database and the storage.

A task is told a job's id and attempt and nothing else of it: the row holds the request, the storage the
table. The worker writes progress and result to the row itself, so that what it has finished counts even when
the scheduler or the server that asked is gone.
"""

from __future__ import annotations

import os
import socket
from functools import cache
from typing import Literal

from api.attempt import Attempt, Ended
from api.blobs import Blobs
from api.place import Place
from api.results import Results
from api.rows import JobRow
from api.storage import open_storage
from api.store import Store
from api.tables import OpenTables
from api.work import Worker
from fitter import _jax
from fitter.memory_maps import forget_when_many

#: Parsed tables that a worker keeps in memory.
TABLES = 2


@cache
def _opened(place: Place) -> tuple[Store, Worker]:
    """The worker's own connections, opened when the first task needs them."""
    _jax.compile_sooner()
    _jax.use_compilation_cache(place.programs)
    store, storage = Store(place.database), open_storage(place.storage)
    tables = OpenTables(Blobs(storage, place.folder), TABLES)
    return store, Worker(store, Results(storage, place.folder), tables)


def work(place: Place, id: str, attempt: int) -> Ended | Literal["lost"]:
    """Do that attempt at that job; "lost" where another worker had begun it and died.

    Raises SQLAlchemyError where the database stays away.
    """
    store, worker = _opened(place)
    job = store.get(JobRow, id)
    if job is None or (job.state, job.attempt) != ("running", attempt):
        return "overtaken"
    if not store.begin(job, f"{socket.gethostname()}:{os.getpid()}"):
        return "lost"
    try:
        return Attempt(store, worker, job, lambda: False).run()
    finally:
        forget_when_many()
