"""Parsing: uploads are read in processes of their own, with limits on memory and time.

Whatever a file does to its reader, it does to that process. One is forked for each upload, in some ten
milliseconds, from a server process that has the readers loaded and nothing else: no threads, no JAX, no data.
The next upload's is forked when the one before has ended, so that it need not wait for that.
"""

from __future__ import annotations

import contextlib
import logging
import mmap
import multiprocessing
import os
import resource
import sys
import threading
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any, cast

import orjson
from anyio import CapacityLimiter

from api.problems import Problem, of_fitter_error
from fitter.errors import FitterError, SpecError

_log = logging.getLogger("brdf_fitter.api")


@dataclass(frozen=True)
class Limits:
    """Of one upload: memory that reading it may take, seconds, samples and channels it may have."""

    bytes: int
    seconds: float
    samples: int
    channels: int


@dataclass(frozen=True)
class Parsed:
    """What an upload is: its own name, and the description of the table."""

    name: str
    description: dict[str, Any]


@dataclass(frozen=True)
class _Reader:
    """A process that reads one upload, and the connection to it."""

    process: ForkServerProcess
    connection: Connection

    def end(self) -> None:
        self.connection.close()
        self.process.kill()
        self.process.join()
        self.process.close()


class Parsers:
    """Reads uploads, ``at_once`` at a time: who calls :meth:`parse` in a thread takes it with ``limiter``."""

    def __init__(self, at_once: int, limits: Limits) -> None:
        self._limits = limits
        self._next: _Reader | None = None
        self._closed = False
        self._lock = threading.Lock()
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload([__name__, "api.readers"])
        self.limiter = CapacityLimiter(at_once)

    def parse(self, path: Path, options: dict[str, Any], sha256: str) -> Parsed:
        """Read the file at ``path``. Raises Problem: the file's fault, or 500 where it is ours."""
        reader = self._given(orjson.dumps({"path": str(path), "options": options, "sha256": sha256}))
        try:
            # JSON, not pickles: what comes out of there is made by what may be a hostile file's code by now.
            answered = reader.connection.poll(self._limits.seconds)
            found: Any = orjson.loads(reader.connection.recv_bytes()) if answered else None
        except (EOFError, ConnectionError):
            reader.process.join()
            found = {"died": reader.process.exitcode}
        finally:
            threading.Thread(target=self._change, args=(reader,)).start()
        if found is None:
            raise _refused("reading-takes-too-long", f"reading it takes more than {self._limits.seconds:g} s")
        if "problem" in found:
            raise Problem.of_document(found["problem"])
        if "memory" in found:
            raise _refused("reading-takes-too-much", f"reading it takes more than {self._limits.bytes} bytes")
        if "died" in found:
            _log.warning("an upload ended its reader (exit code %s)", found["died"])
            raise _refused("reading-fails", "its reader did not survive it")
        if "bug" in found:
            _log.error("an upload can't be read because of a mistake in its reader:\n%s", found["bug"])
            raise RuntimeError("a reader failed")
        return Parsed(found["name"], found["description"])

    def _given(self, work: bytes) -> _Reader:
        """A process that has been told what to read: the one that waits, if there is one."""
        with self._lock:
            waiting, self._next = self._next, None
        if waiting is not None:
            try:
                waiting.connection.send_bytes(work)
                return waiting
            except ConnectionError:
                _log.warning("a reader that waited for an upload has been ended by somebody else")
                waiting.end()
        fresh = self._started()
        with contextlib.suppress(ConnectionError):  # It has died: no answer will come, which says so.
            fresh.connection.send_bytes(work)
        return fresh

    def _started(self) -> _Reader:
        ours, theirs = cast("tuple[Connection, Connection]", self._context.Pipe())
        process = self._context.Process(target=_read, args=(theirs, self._limits), daemon=True)
        process.start()
        theirs.close()
        return _Reader(process, ours)

    def _change(self, used: _Reader) -> None:
        """End a process that has read, and have the next one wait."""
        used.end()
        with self._lock:
            if self._next is None and not self._closed:
                try:
                    self._next = self._started()
                except OSError:
                    _log.warning("no reader waits: the next upload starts its own", exc_info=True)

    def close(self) -> None:
        """End the process that waits; none will from now on."""
        with self._lock:
            waiting, self._next, self._closed = self._next, None, True
        if waiting is not None:
            waiting.end()


def _refused(code: str, detail: str) -> Problem:
    return Problem.invalid(
        code, detail, cause="the file is damaged, or made to do that, or larger than it seems",
        remedy="send a smaller table, or have the server's operator raise the limit",
    )  # fmt: skip


def _read(connection: Connection, limits: Limits) -> None:
    """The process: wait for an upload, read it, and say what came of it."""
    _limit(limits)
    try:
        work = orjson.loads(connection.recv_bytes())
    except EOFError:  # There is no server any more.
        return
    try:
        found = _described(Path(work["path"]), work["options"], work["sha256"], limits)
    except FitterError as error:
        found = {"problem": of_fitter_error(error)}
    except MemoryError:
        found = {"memory": limits.bytes}
    except Exception as error:
        # Libraries have memory errors of their own, and a thread's stack is memory, too.
        memory = (
            "memory" in type(error).__name__.lower() or isinstance(error.__cause__, MemoryError)
            or "start new thread" in str(error)
        )  # fmt: skip
        found = {"memory": limits.bytes} if memory else {"bug": traceback.format_exc()}
    with contextlib.suppress(BrokenPipeError):
        connection.send_bytes(orjson.dumps(found, option=orjson.OPT_SERIALIZE_NUMPY))


def _described(path: Path, options: dict[str, Any], sha256: str, limits: Limits) -> dict[str, Any]:
    from api.readers import describe, parse

    table = parse(_mapped(path), options, sha256)
    samples, channels = table.value.shape
    for count, most, noun in ((samples, limits.samples, "samples"), (channels, limits.channels, "channels")):
        if count > most:
            raise SpecError(
                f"the table has {count} {noun}, more than the limit of {most}", code=f"too-many-{noun}",
                remedy="send a part of it, or have the server's operator raise the limit",
            )  # fmt: skip
    return {"name": table.metadata.name, "description": describe(table)}


def _mapped(path: Path) -> bytes | memoryview:
    """The file's bytes, not read but mapped: nobody else knows the file, so that nobody changes it."""
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size == 0:
            return b""
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def _limit(limits: Limits) -> None:
    """No more memory than the limits say on top of what the process has, and no core dumps."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        # Private memory, as the kernel counts it: libraries reserve addresses that they never use.
        pages = int(Path("/proc/self/statm").read_text().split()[5])
        most = pages * os.sysconf("SC_PAGE_SIZE") + limits.bytes
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
