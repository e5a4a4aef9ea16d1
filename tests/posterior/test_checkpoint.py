"""Checkpoints: a killed run goes on and gives the draws of one that was never stopped."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import fitter
from fitter import SpecError, models
from fitter.posterior.checkpoint import Checkpoint
from fitter.progress import Cancelled
from tests.fitting.conftest import scattered

#: So many effective samples that there are many segments to be killed between.
LONG = {"ess": 20_000, "seed": 3, "walkers": 12, "budget_seconds": 300.0}

PROGRAM = """
import sys
import fitter
table, fit = fitter.load(sys.argv[1]), fitter.load_fit(sys.argv[2])
fitter.posterior(table, fit, checkpoint=sys.argv[3], ess=20_000, seed=3, walkers=12, budget_seconds=300.0)
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A table, a fit of it, their files, and the posterior of an uninterrupted run."""
    folder = tmp_path_factory.mktemp("checkpoint")
    model = models.create("ward", kd=0.2, ks=0.06, alpha=0.15)
    made = scattered(model, seed=1, n=300, noise=0.05, sigma=True)
    fitter.write(made, folder / "table.npz")
    table = fitter.load(folder / "table.npz")
    fit = fitter.fit(table, "ward")
    fit.save(folder / "fit.json")
    return folder, table, fit, fitter.posterior(table, fit, **LONG)


@pytest.mark.long
def test_a_killed_process_goes_on_to_the_same_bits(work):
    folder, table, fit, whole = work
    kept = folder / "killed"
    words = [sys.executable, "-c", PROGRAM, str(folder / "table.npz"), str(folder / "fit.json"), str(kept)]
    process = subprocess.Popen(words)
    end = time.monotonic() + 120
    while len(list(kept.glob("segment-*.npz"))) < 2 and process.poll() is None and time.monotonic() < end:
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL, "the run was over before it was killed"
    (kept / ".segment-00099.npz.aside").write_bytes(b"half a")  # what a kill in a write leaves
    again = fitter.posterior(table, fit, checkpoint=kept, **LONG)
    assert again.cost["resumed_at_step"] >= 100
    assert again.status == whole.status == "converged"
    np.testing.assert_array_equal(again.draws, whole.draws)
    assert again.diagnostics == whole.diagnostics
    assert [h["rhat"] for h in again.history] == [h["rhat"] for h in whole.history]
    assert again.seconds > sum(again.cost["phases"][name] for name in ("mode", "tuning", "sampling"))


def test_a_run_that_ended_too_early_goes_on_with_more_time(work):
    folder, table, fit, whole = work
    kept = folder / "early"
    short = fitter.posterior(table, fit, checkpoint=kept, **{**LONG, "budget_seconds": 1e-3})
    assert short.status == "not_converged"
    again = fitter.posterior(table, fit, checkpoint=kept, **LONG)
    assert again.cost["resumed_at_step"] == short.cost["steps"]
    np.testing.assert_array_equal(again.draws, whole.draws)


def test_stopped_before_its_first_segment_it_begins_with_that(work):
    folder, table, fit, whole = work

    def stop(share, what):
        if "sampling" in what:
            raise Cancelled

    with pytest.raises(Cancelled):
        fitter.posterior(table, fit, checkpoint=folder / "stopped", progress=stop, **LONG)
    again = fitter.posterior(table, fit, checkpoint=folder / "stopped", **LONG)
    np.testing.assert_array_equal(again.draws, whole.draws)


def test_another_run_is_refused(work):
    folder, table, fit, _ = work
    kept = folder / "other"
    fitter.posterior(table, fit, checkpoint=kept, seed=1, budget_seconds=1e-3)
    for changed in ({"seed": 2}, {"walkers": 16}, {"likelihood": "student_t"}):
        with pytest.raises(SpecError, match="belongs to another run") as caught:
            fitter.posterior(table, fit, checkpoint=kept, **{"seed": 1, **changed})
        assert caught.value.code == "checkpoint-other-run"
    other = fitter.Table(wi=table.wi, wo=table.wo, value=1.1 * table.value, sigma=table.sigma)
    with pytest.raises(SpecError, match="belongs to another run"):
        fitter.posterior(other, fit, checkpoint=kept, seed=1)
    with pytest.raises(SpecError, match="not a checkpoint"):
        fitter.posterior(table, fit, checkpoint=folder)


def test_a_damaged_checkpoint_is_named(work):
    folder, table, fit, _ = work
    kept = folder / "damaged"
    fitter.posterior(table, fit, checkpoint=kept, seed=1, budget_seconds=1e-3)
    segment = kept / "segment-00000.npz"
    whole = segment.read_bytes()
    for content in (b"", b"PK", whole[: len(whole) // 2]):
        segment.write_bytes(content)
        with pytest.raises(SpecError) as caught:
            fitter.posterior(table, fit, checkpoint=kept, seed=1, budget_seconds=1e-3)
        assert caught.value.code == "checkpoint-damaged"
    segment.rename(kept / "segment-00001.npz")
    with pytest.raises(SpecError, match="checkpoint can't be read"):
        fitter.posterior(table, fit, checkpoint=kept, seed=1, budget_seconds=1e-3)
    Checkpoint(kept, "").remove()
    assert not kept.exists()
