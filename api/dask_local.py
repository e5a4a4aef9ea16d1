"""The local cluster: a Dask scheduler and workers on this machine, each a process of its own, kept alive."""

from __future__ import annotations

import logging
import subprocess
import sys
import threading
import time
from pathlib import Path

_log = logging.getLogger("brdf_fitter.api")

#: Seconds between two looks whether everything lives.
LOOK_EVERY = 0.25
#: A process that died younger than this (seconds) waits as long before it is started again.
YOUNG = 2.0


class _Process:
    """One process, spawned and not forked: the server has threads, and locks that they hold."""

    def __init__(self, *words: str) -> None:
        self.born = time.monotonic()
        # Only the scheduler is listened to: a pipe that nobody reads stops, once full, who writes to it.
        out = subprocess.DEVNULL if words else subprocess.PIPE
        command = [sys.executable, "-m", "api.dask_process", *words]
        self.popen = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=out)

    def address(self) -> str:
        """What it says once it listens; empty where it died before."""
        assert self.popen.stdout is not None
        return self.popen.stdout.readline().decode().strip()

    @property
    def alive(self) -> bool:
        return self.popen.poll() is None

    def end(self) -> None:
        if self.alive:
            self.popen.kill()
        self.popen.wait()
        for pipe in (self.popen.stdin, self.popen.stdout):
            if pipe is not None:
                pipe.close()


class LocalCluster:
    """Starts the processes and starts those again that die. Without its scheduler everything begins anew."""

    def __init__(self, workers: int, folder: Path) -> None:
        self._count = workers
        self._folder = folder
        self._scheduler: _Process | None = None
        self._workers: list[_Process] = []
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="dask-cluster", daemon=True)
        #: The scheduler's address; None while there is none.
        self.address: str | None = None

    def start(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join()
        self._end()

    def pids(self) -> dict[str, list[int]]:
        """The processes, for who watches them."""
        scheduler = self._scheduler
        return {
            "scheduler": [scheduler.popen.pid] if scheduler is not None else [],
            "worker": [one.popen.pid for one in self._workers],
        }

    def _keep(self) -> None:
        while not self._stopping.is_set():
            try:
                self._look()
            except Exception:
                _log.exception("the local Dask cluster can't be started; trying again")
                self._stopping.wait(YOUNG)
            self._stopping.wait(LOOK_EVERY)

    def _look(self) -> None:
        if self._scheduler is None or not self._scheduler.alive:
            if self._scheduler is not None:
                _log.warning("the Dask scheduler died; it is started again")
                self._wait_if_young(self._scheduler)
            self._end()
            self._scheduler = _Process()
            self.address = self._scheduler.address() or None
        if self.address is None:
            return
        for dead in [one for one in self._workers if not one.alive]:
            _log.warning("a Dask worker died (exit status %s); it is started again", dead.popen.returncode)
            self._wait_if_young(dead)
            dead.end()
            self._workers.remove(dead)
        while len(self._workers) < self._count:
            self._workers.append(_Process("--scheduler", self.address, "--folder", str(self._folder)))

    def _wait_if_young(self, dead: _Process) -> None:
        if time.monotonic() - dead.born < YOUNG:
            self._stopping.wait(YOUNG)

    def _end(self) -> None:
        self.address = None
        processes = [*self._workers, *([self._scheduler] if self._scheduler is not None else [])]
        self._workers, self._scheduler = [], None
        for one in processes:
            one.end()
