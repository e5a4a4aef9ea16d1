"""Engines: what does the work of a leased job. A thread can: the numerics release the lock."""

from __future__ import annotations

import threading
from typing import Protocol

from api.attempt import Attempt, Ended
from api.rows import JobRow
from api.store import Store
from api.work import Worker


class Lost(Exception):
    """Who worked on the attempt is gone. ``blame`` : it may be the job's doing."""

    def __init__(self, why: str, *, blame: bool = True) -> None:
        super().__init__(why)
        self.blame = blame


class Engine(Protocol):
    """What does the work of a leased job."""

    def start(self) -> None: ...

    def ready(self) -> bool:
        """Whether it makes sense to lease a job now."""
        ...

    def run(self, job: JobRow, stopping: threading.Event) -> Ended:
        """Work on the attempt until it has ended. Raises Lost where whoever did is gone."""
        ...

    def stop(self) -> None: ...


class InProcess:
    """The engine that is nothing but the thread that asks."""

    def __init__(self, store: Store, worker: Worker) -> None:
        self._store = store
        self._worker = worker

    def start(self) -> None: ...

    def ready(self) -> bool:
        return True

    def run(self, job: JobRow, stopping: threading.Event) -> Ended:
        # The row says that the job runs in this process: if that dies, it may be the job's doing.
        if not self._store.begin(job, str(job.server)):
            return "overtaken"
        return Attempt(self._store, self._worker, job, stopping.is_set).run()

    def stop(self) -> None: ...
