"""A batch on a real cluster of this machine: scheduler and workers are processes of their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from fitter.batch import batch_spec, cluster, plan, run
from fitter.progress import Cancelled
from tests.batch.conftest import Write, rows_without_times

pytestmark = pytest.mark.long

_COUNT = 14
#: Seconds that a process may take to start on a busy machine.
_PATIENCE = 120.0


@contextmanager
def _started(*words: str) -> Generator[subprocess.Popen[bytes]]:
    """A process of Dask that ends with the block."""
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _wait(until: Callable[[], Any], what: str) -> None:
    end = time.monotonic() + _PATIENCE
    while not until():
        assert time.monotonic() < end, f"{what} did not come up"
        time.sleep(0.1)


def test_tables_of_one_file_are_shared_out(tmp_path: Path, write_table: Write) -> None:
    """The workers' record is the one that a single process writes, and keeps what had been finished."""
    one = [write_table(tmp_path / f"t{k}.csv", 0.1 + 0.05 * k).read_text().splitlines() for k in range(10)]
    text = [f"{one[0][0]},item", *(f"{row},s{k}" for k in range(10) for row in one[k][1:])]
    (tmp_path / "all.csv").write_text("\n".join([*text, ""]))
    what = plan(batch_spec({"tables": [str(tmp_path / "all.csv")], "models": ["ward"], "report": False}))
    found = run(what, tmp_path / "two", workers=2)
    assert (found.done, found.failed) == (1, 0)

    seen: list[float] = []

    def stop(share: float, words: str) -> None:
        seen.append(share)
        if share > 0.35:
            raise Cancelled

    with pytest.raises(Cancelled):
        run(what, tmp_path / "one", workers=1, progress=stop)
    assert seen == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("one/tables/all/*/table.json")}
    assert len(before) == 4
    assert run(what, tmp_path / "one", workers=1).done == 1
    assert all(path.stat().st_mtime_ns == when for path, when in before.items())
    rows = rows_without_times(tmp_path / "two")
    assert [row["table"] for row in rows] == [f"all/s{k}" for k in range(10)]
    assert rows == rows_without_times(tmp_path / "one")


class _Recorder:
    """A client that notes the keys of what it is given to do."""

    def __init__(self) -> None:
        self.keys: list[str] = []

    def submit(self, *_: Any, key: str, **__: Any) -> str:
        self.keys.append(key)
        return key


def test_tasks_of_one_key_are_one_task(tmp_path: Path, write_table: Write) -> None:
    """A scheduler does what has one key once, whoever asks: the same table for another folder, or in other
    shares, is another task."""
    table = str(write_table(tmp_path / "t.csv", 0.3))
    what = plan(batch_spec({"tables": [table], "models": ["lambert"], "report": False}))
    (unit,), key = what.units, what.units[0].key(what.work)
    keys: list[list[str]] = []
    for folder in ("a", "a", "b"):
        client: Any = _Recorder()
        tasks = [cluster._Task(unit, key, share) for share in (None, (0, 2), (1, 2), (0, 3))]
        list(cluster._submitted(client, tasks, {}, tmp_path / folder))
        keys.append(client.keys)
    assert keys[0] == keys[1]
    assert len({*keys[0], *keys[2]}) == 8


_DEADLY = """\
import os, time
from fitter.batch import working

def dask_setup(worker):
    real = working.work

    def work(unit, *rest, **more):
        if unit["name"] == "t3":
            time.sleep(0.5)  # others come to wait at this worker
            os._exit(1)
        return real(unit, *rest, **more)

    working.work = work
"""


def test_a_table_that_ends_its_workers_fails_alone(tmp_path: Path, write_table: Write) -> None:
    """Also where the scheduler suspects those that waited at the same workers."""
    dask = pytest.importorskip("dask")

    for k in range(8):
        write_table(tmp_path / "tables" / f"t{k}.csv", 0.1 + 0.05 * k)
    (tmp_path / "deadly.py").write_text(_DEADLY)
    what = plan(batch_spec({"tables": [str(tmp_path / "tables")], "models": ["lambert"], "report": False}))
    settings = {
        "distributed.worker.preload": [str(tmp_path / "deadly.py")],
        "distributed.scheduler.allowed-failures": 0,
    }
    with dask.config.set(settings):
        found = run(what, tmp_path / "out", workers=2)
    assert (found.done, found.failed) == (8, 1)
    rows = rows_without_times(tmp_path / "out")
    assert [row["table"] for row in rows] == [f"t{k}" for k in range(8)]
    assert [row["table"] for row in rows if row["error"]] == ["t3"]
    assert "every worker that began this table died" in rows[3]["error"]


def test_one_worker_added_and_one_killed(tmp_path: Path, write_table: Write) -> None:
    """All results once, and the same numbers as in one process left alone."""
    pytest.importorskip("distributed")
    from distributed import Client

    for k in range(_COUNT):
        write_table(tmp_path / "tables" / f"t{k:02}.csv", 0.1 + 0.05 * k)
    what = plan(
        batch_spec(
            {"tables": [str(tmp_path / "tables")], "models": ["oren_nayar"], "report": False, "seed": 3}
        )
    )
    told = tmp_path / "scheduler.json"
    with ExitStack() as started:

        def begin(*words: str) -> subprocess.Popen[bytes]:
            return started.enter_context(_started(*words))

        def worker(number: int) -> subprocess.Popen[bytes]:
            return begin(
                "worker", "--scheduler-file", str(told), "--nthreads", "1", "--no-nanny", "--no-dashboard",
                "--name", str(number), "--local-directory", str(tmp_path / "dask"),
            )  # fmt: skip

        begin(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
            "--scheduler-file", str(told),
        )  # fmt: skip
        _wait(told.exists, "the scheduler")
        address = str(json.loads(told.read_text())["address"])
        first = [worker(0), worker(1)]
        client: Any = started.enter_context(Client(address, set_as_default=False, timeout=_PATIENCE))
        client.wait_for_workers(2, timeout=_PATIENCE)
        events: list[str] = []

        def disturb(share: float, words: str) -> None:
            if not events and share > 0:
                worker(2)
                client.wait_for_workers(3, timeout=_PATIENCE)
                events.append("added")
            elif events == ["added"] and "running" in words:
                info = client.scheduler_info(n_workers=-1)["workers"]
                (victim,) = [at for at, one in info.items() if str(one["name"]) == "0"]
                if client.processing([victim])[victim]:
                    os.kill(first[0].pid, signal.SIGKILL)
                    events.append("killed")

        found = run(what, tmp_path / "disturbed", scheduler=address, progress=disturb)
        assert events == ["added", "killed"]
        assert first[0].wait() == -signal.SIGKILL
        assert {str(one["name"]) for one in client.scheduler_info(n_workers=-1)["workers"].values()} == {
            "1", "2",
        }  # fmt: skip
    assert (found.done, found.kept, found.failed) == (_COUNT, 0, 0)
    run(what, tmp_path / "alone", workers=1)
    rows = rows_without_times(tmp_path / "disturbed")
    assert [row["table"] for row in rows] == [f"t{k:02}" for k in range(_COUNT)]
    assert rows == rows_without_times(tmp_path / "alone")
