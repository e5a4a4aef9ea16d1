"""Jobs: the queue, its states, and what happens when things go wrong. The work itself is a stand-in."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy.exc import OperationalError

from api.engine import InProcess
from api.jobs import EXHAUSTED, Runner
from api.metrics import Metrics
from api.queue import STARTS
from api.rows import JobRow, PosteriorRow, TableRow
from api.states import CANCELLED, DONE, FAILED, QUEUED, RUNNING
from api.store import InUse, Missing, QueueFull, Store, new_id
from api.work import Outcome
from fitter.errors import FitError
from fitter.progress import Progress
from tests.api.databases import KINDS, database

LEASE = 30.0


@pytest.fixture(params=KINDS)
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    with database(request.param, tmp_path) as url:
        opened = Store(url)
        yield opened
        opened.close()


@pytest.fixture
def kept(store: Store) -> str:
    row = TableRow(id=new_id(), created=0.0, name="t", sha256="0" * 64, size=1, options={}, description={})
    store.add(row)
    return row.id


def queued(store: Store, kept: str) -> JobRow:
    job = JobRow(id=new_id(), created=time.time(), kind="fit", table_id=kept, request={})
    store.add_job(job, 100)
    return job


def state(store: Store, job: JobRow) -> str:
    row = store.get(JobRow, job.id)
    assert row is not None
    return row.state


class StandIn:
    """A worker whose work is a function."""

    def __init__(self, work: Callable[[Progress], Outcome]) -> None:
        self._work = work
        self.discarded: list[Outcome] = []

    def run(self, job: JobRow, progress: Progress) -> Outcome:
        return self._work(progress)

    def forget(self, job: JobRow) -> None: ...

    def discard(self, outcome: Outcome) -> None:
        self.discarded.append(outcome)


def run(store: Store, work: Callable[[Progress], Outcome], threads: int = 1) -> Runner:
    return started(store, StandIn(work), threads)


def started(
    store: Store, worker: StandIn, threads: int = 1, metrics: Metrics | None = None
) -> Runner:  # fmt: skip
    runner = Runner(store, InProcess(store, worker), metrics or Metrics(), threads)  # type: ignore[arg-type]
    runner.start()
    return runner


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_database_that_is_away_is_not_held_against_a_job(store: Store, kept: str) -> None:
    """What work reads may be out of reach for a while; where it stays so the job ends with that reason."""
    begun: list[str] = []

    def reads(progress: Progress) -> Outcome:
        begun.append("first")
        if len(begun) == 1:
            raise OperationalError("select", {}, Exception("connection refused"))
        return Outcome(results=[{"kind": "fit"}])

    job = queued(store, kept)
    runner = run(store, reads)
    until(lambda: state(store, job) in (DONE, FAILED))
    runner.stop(5)
    row = store.get(JobRow, job.id)
    assert row is not None
    assert (row.state, row.attempt, row.results) == (DONE, 2, [{"kind": "fit"}])

    def never(progress: Progress) -> Outcome:
        raise OperationalError("select", {}, Exception("connection refused"))

    other = queued(store, kept)
    metrics = Metrics()
    runner = started(store, StandIn(never), metrics=metrics)
    until(lambda: state(store, other) in (DONE, FAILED))
    runner.stop(5)
    assert b'brdf_job_runs_total{kind="fit",state="failed"} 1.0' in metrics.text({})
    row = store.get(JobRow, other.id)
    assert row is not None
    assert row.problem is not None
    assert (row.state, row.problem["code"]) == (FAILED, "database-away")


def test_done_failed_and_unforeseen(store: Store, kept: str) -> None:
    def fails(progress: Progress) -> Outcome:
        raise FitError("too few", code="too-few-samples", remedy="measure more")

    def breaks(progress: Progress) -> Outcome:
        raise RuntimeError("secret detail")

    works: list[Callable[[Progress], Outcome]] = [lambda _: Outcome(results=[{"kind": "fit"}]), fails, breaks]
    jobs = [queued(store, kept) for _ in works]
    runner = run(store, lambda progress: works.pop(0)(progress))
    until(lambda: all(state(store, job) in (DONE, FAILED) for job in jobs))
    runner.stop(5)
    done, failed, broken = (store.get(JobRow, job.id) for job in jobs)
    assert done is not None
    assert (done.state, done.results, done.share) == (DONE, [{"kind": "fit"}], 1.0)
    assert failed is not None
    assert failed.problem is not None
    assert failed.problem["code"] == "too-few-samples"
    assert broken is not None
    assert broken.problem is not None
    assert broken.problem["code"] == "internal-error"
    assert "secret" not in str(broken.problem)


def test_cancel(store: Store, kept: str) -> None:
    running = threading.Event()

    def endless(progress: Progress) -> Outcome:
        while True:
            progress(0.5, "working")
            running.set()
            time.sleep(0.01)

    job, waiting = queued(store, kept), queued(store, kept)
    runner = run(store, endless)
    assert running.wait(20)
    assert store.cancel(waiting.id).state == CANCELLED
    assert store.cancel(job.id).state == RUNNING
    until(lambda: state(store, job) == CANCELLED)
    runner.stop(5)
    assert store.claim("here", LEASE) is None


def test_graceful_stop_puts_the_job_back(store: Store, kept: str) -> None:
    running = threading.Event()

    def endless(progress: Progress) -> Outcome:
        while True:
            running.set()
            progress(0.5, "working")
            time.sleep(0.01)

    job = queued(store, kept)
    runner = run(store, endless)
    assert running.wait(20)
    assert runner.stop(20)
    row = store.get(JobRow, job.id)
    assert row is not None
    assert (row.state, row.attempt, row.losses) == (QUEUED, 1, 0)


def test_dead_process_is_recovered_and_poison_given_up(store: Store, kept: str) -> None:
    job = queued(store, kept)
    for attempt in (1, 2, 3):
        claimed = store.claim("here", LEASE)
        assert claimed is not None
        assert claimed.attempt == attempt
        assert store.begin(claimed, "here")
        assert store.recover(3, EXHAUSTED, everything=True) == (1 if attempt < 3 else 0)
    row = store.get(JobRow, job.id)
    assert row is not None
    assert row.state == FAILED
    assert row.problem == EXHAUSTED


@pytest.mark.parametrize("worker", [None, "machine:123"])
def test_a_server_s_death_is_held_against_no_job_that_ran_elsewhere(
    store: Store, kept: str, worker: str | None
) -> None:
    job = queued(store, kept)
    for attempt in range(1, 3 * STARTS + 1):
        claimed = store.claim("here", LEASE)
        assert claimed is not None
        assert worker is None or store.begin(claimed, worker)
        assert store.recover(3, EXHAUSTED, everything=True) == (1 if attempt < 3 * STARTS else 0)
    row = store.get(JobRow, job.id)
    assert row is not None
    # Started again, but not without end.
    assert (row.state, row.losses, row.problem) == (FAILED, 0, EXHAUSTED)


def test_cancelled_job_of_a_dead_process_is_not_run_again(store: Store, kept: str) -> None:
    job = queued(store, kept)
    store.claim("here", LEASE)
    store.cancel(job.id)
    assert store.recover(3, EXHAUSTED, everything=True) == 0
    assert state(store, job) == CANCELLED


def test_late_result_of_an_old_attempt_is_not_published(store: Store, kept: str) -> None:
    job = queued(store, kept)
    old = store.claim("here", LEASE)
    assert old is not None
    store.recover(3, EXHAUSTED, everything=True)
    new = store.claim("here", LEASE)
    assert new is not None
    row = PosteriorRow(id=new_id(), created=0.0, fit_id="0" * 32, job_id=job.id, summary={})
    assert not store.publish(old, [row], [{"late": True}])
    assert store.get(PosteriorRow, row.id) is None
    assert store.advance(old, 0.5, "late")
    assert not store.fail(old, {}, [])
    assert store.publish(new, [], [{"good": True}])
    assert not store.publish(new, [], [{"again": True}])
    found = store.get(JobRow, job.id)
    assert found is not None
    assert found.results == [{"good": True}]


def test_unpublished_files_are_discarded(store: Store, kept: str) -> None:
    job = queued(store, kept)

    def overtaken(progress: Progress) -> Outcome:
        store.recover(3, EXHAUSTED, everything=True)
        store.cancel(job.id)
        return Outcome(rows=[JobRow(id=new_id())])

    worker = StandIn(overtaken)
    runner = started(store, worker)
    until(lambda: bool(worker.discarded))
    runner.stop(5)
    assert state(store, job) == CANCELLED


def test_many_threads_claim_each_job_once(store: Store, kept: str) -> None:
    jobs = [queued(store, kept) for _ in range(40)]
    seen: list[int] = []

    def work(progress: Progress) -> Outcome:
        progress(0.5, "half")
        seen.append(1)
        return Outcome()

    runner = run(store, work, threads=8)
    until(lambda: all(state(store, job) == DONE for job in jobs))
    runner.stop(5)
    assert len(seen) == 40


def test_table_in_use_and_queue_limits(store: Store, kept: str) -> None:
    job = queued(store, kept)
    with pytest.raises(InUse):
        store.delete_table(kept)
    with pytest.raises(QueueFull):
        store.add_job(JobRow(id=new_id(), created=0.0, kind="fit", table_id=kept, request={}), 1)
    store.cancel(job.id)
    assert store.delete_table(kept) == "0" * 64
    for missing in (kept, "x", "\x00"):
        with pytest.raises(Missing):
            store.delete_table(missing)
    with pytest.raises(Missing):
        queued(store, kept)


def test_over_http(serving: Any, table_bytes: bytes) -> None:
    client = serving(workers=0, max_queue=1)
    table = client.post("/v1/tables", content=table_bytes).json()["id"]
    first = client.post("/v1/fits", json={"table": table, "model": "ward"})
    full = client.post("/v1/fits", json={"table": table, "model": "ward"})
    assert (full.status_code, full.json()["code"], full.headers["retry-after"]) == (429, "queue-full", "30")
    assert client.delete(f"/v1/tables/{table}").json()["code"] == "table-in-use"
    here = first.headers["location"]
    assert [one["id"] for one in client.get("/v1/jobs?state=queued").json()["items"]] == [first.json()["id"]]
    assert client.get("/v1/jobs?state=done").json()["total"] == 0
    assert client.post(f"{here}/cancel").json()["state"] == "cancelled"
    assert client.post(f"{here}/cancel").status_code == 202
    with client.stream("GET", f"{here}/events") as stream:
        lines = list(stream.iter_lines())
    assert stream.headers["content-type"].startswith("text/event-stream")
    assert [line for line in lines if line.startswith(("id", "event"))] == [
        "event: progress", "id: 1", "event: cancelled", "id: 2",
    ]  # fmt: skip
    replayed = client.get(f"{here}/events", headers={"Last-Event-ID": "1"}).text
    assert "id: 2" in replayed
    assert "id: 1" not in replayed
    assert client.get(f"{here}/events", headers={"Last-Event-ID": "x"}).status_code == 422
    missing = client.get(f"/v1/jobs/{'0' * 32}/events")
    assert missing.headers["content-type"] == "application/problem+json"


def test_finished_job_can_not_be_cancelled(client: Any, job: dict[str, Any]) -> None:
    answer = client.post(f"/v1/jobs/{job['id']}/cancel")
    assert (answer.status_code, answer.json()["code"]) == (409, "job-finished")


@pytest.mark.parametrize(("begun", "losses"), [(True, 1), (False, 0)])
def test_a_worker_s_death_is_held_against_the_job_it_was_at(
    store: Store, kept: str, begun: bool, losses: int
) -> None:
    queued(store, kept)
    claimed = store.claim("here", LEASE)
    assert claimed is not None
    assert not begun or store.begin(claimed, "machine:123")
    assert store.give_back(claimed, 3, EXHAUSTED)
    row = store.get(JobRow, claimed.id)
    assert row is not None
    assert (row.state, row.losses) == (QUEUED, losses)
