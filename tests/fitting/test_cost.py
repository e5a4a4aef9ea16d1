"""What a fit costs is said, compiling apart; a fit that looks at a subset only says how far off it may be."""

from __future__ import annotations

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fitter
from fitter import models
from fitter.compression import compress
from fitter.fitting.clock import running
from fitter.fitting.compiling import Meter, metering
from fitter.fitting.memory import MemoryWatch, resident
from fitter.fitting.search_error import rms_share
from tests.fitting.conftest import scattered

ROUGH = {"rho": [0.3, 0.5, 0.7], "sigma": 0.5}


@pytest.fixture(scope="module")
def table() -> fitter.Table:
    return scattered(models.create("oren_nayar", **ROUGH), seed=5, n=3000, noise=0.05)


def test_overlapping_compilations_count_once():
    meter = Meter([(1.0, 4.0), (2.0, 3.0), (3.5, 5.0), (7.0, 8.0), (7.0, 7.5)])
    assert meter.between(0.0, 10.0) == pytest.approx(5.0)
    assert meter.between(3.0, 7.5) == pytest.approx(2.5)
    assert meter.between(5.0, 7.0) == 0.0


def test_compiling_is_heard_in_this_thread_and_told_to_no_other():
    def compile_something(shift: float) -> None:
        jax.jit(lambda x: jnp.sin(x) * shift)(jnp.ones(3)).block_until_ready()

    heard: list[float] = []

    def elsewhere() -> None:
        with metering() as meter:
            started.set()
            done.wait(60)
            heard.append(meter.between(0.0, 1e12))

    started, done = threading.Event(), threading.Event()
    other = threading.Thread(target=elsewhere)
    other.start()
    started.wait(60)
    with metering() as mine:
        compile_something(0.123)
        spent = mine.between(0.0, 1e12)
    done.set()
    other.join()
    assert spent > 0
    assert heard == [0.0]


def test_a_clock_tells_compiling_from_working():
    with running() as clock:
        jax.jit(lambda x: jnp.cos(x) * 0.321)(jnp.ones(3)).block_until_ready()
        clock.lap("first")
        clock.lap("second")
    cost = clock.cost(0.25)
    assert list(cost["phases"]) == ["load", "compile", "first", "second"]
    assert cost["phases"]["compile"] == cost["compiled_in"]["first"] > 0
    # What was loaded before is no second of the fit.
    assert cost["seconds"] == pytest.approx(sum(cost["phases"].values()) - 0.25)


def test_memory_is_seen_at_its_peak():
    size = 64 << 20
    with MemoryWatch() as watch:
        held = np.ones(size // 8)
        held += 1.0
        during = resident()
        del held
        peak, growth = watch.read()
    assert during is not None
    assert growth is not None
    assert peak >= during - (1 << 20)  # the system counts in batches
    assert growth >= 0.9 * size


def test_a_fit_says_what_it_cost(table):
    fitter.fit(table, "oren_nayar")
    cost = fitter.fit(table, "oren_nayar").cost
    assert {"compile", "prepare", "search", "polish", "check"} <= set(cost["phases"])
    assert cost["phases"]["compile"] == 0.0
    assert cost["seconds"] == pytest.approx(sum(cost["phases"].values()))
    assert cost["peak_memory_bytes"] > 0
    assert "load" not in cost["phases"]


def test_a_loaded_table_knows_its_seconds(tmp_path, table):
    path = tmp_path / "table.csv"
    fitter.write(table, path, "delimited")
    loaded = fitter.load(path)
    assert loaded.load_seconds > 0
    assert fitter.fit(loaded, "oren_nayar").cost["phases"]["load"] == loaded.load_seconds


def test_a_subset_alone_keeps_its_word(table):
    """Its search error bounds how far the table's own objective is above the optimum, in nearly all draws."""
    best = fitter.fit(table, "oren_nayar", metric="cosine")
    assert best.evidence["search_error"] < 1e-7
    assert best.evidence["selection_error"] is None

    def values(fit: fitter.FitResult) -> np.ndarray:
        return np.concatenate([np.ravel(one.value) for one in fit.parameters.values()])

    kept, moved = 0, []
    for seed in range(20):
        fit = fitter.fit(table, "oren_nayar", metric="cosine", subset=512, polish="subset", seed=seed)
        assert fit.status == "converged"
        assert "subset" in fit.message
        assert (fit.cost["passes"], fit.uncertainty) == (0, "sandwich")
        wi = table.wi
        off = wi[:, 2:] * (np.asarray(fit.model.evaluate(wi, table.wo)) - table.value)
        found = np.sqrt(np.mean(off**2) / best.metrics["objective"]) - 1.0
        assert found > -1e-9
        kept += found <= fit.evidence["search_error"]
        stated = np.array([fit.evidence["selection_error"][label] for label in fit.labels])
        moved.append((values(fit) - values(best)) / np.sqrt(np.diag(best.covariance)) / stated)
        assert f"{stated.max():.2g} standard errors" in fit.message
    # 95 % each: fewer than 16 of 20 has a probability below 0.3 %.
    assert kept >= 16
    # And what it says the choice of samples does to the parameters is what it does. Systematic samples of one
    # table in six are six different ones at most: their rms is uncertain by a third.
    assert 0.4 < np.sqrt(np.mean(np.square(moved))) < 1.8


def test_a_subset_says_how_well_it_stands_for_the_table(table):
    """Its rmse and its uncertainties are those of the table's estimate from so few samples."""
    best = fitter.fit(table, "oren_nayar", metric="cosine")
    fits = [
        fitter.fit(table, "oren_nayar", metric="cosine", subset=512, polish="subset", seed=seed)
        for seed in range(20)
    ]
    rmse = np.mean([fit.metrics["rmse"] for fit in fits])
    assert rmse == pytest.approx(best.metrics["rmse"], rel=0.05)
    there = best.parameters["rho"].value
    pulls = [
        (rho.value - there) / rho.standard_uncertainty for rho in (fit.parameters["rho"] for fit in fits)
    ]
    assert 0.4 < np.sqrt(np.mean(np.square(pulls))) < 1.6


def test_a_subset_that_is_the_whole_table_is_the_fit(table):
    whole = fitter.fit(table, "oren_nayar")
    same = fitter.fit(table, "oren_nayar", polish="subset")
    assert same.message == whole.message
    np.testing.assert_array_equal(same.parameters["rho"].value, whole.parameters["rho"].value)


def test_compressed_tables_cost_their_reading(table):
    assert fitter.fit(compress(table, 0.01), "oren_nayar").cost["seconds"] > 0


@pytest.mark.parametrize("share", [0.0, 1e-12, 0.01, 3.0])
def test_rms_share(share):
    assert rms_share(share) == pytest.approx(np.expm1(0.5 * np.log1p(share)), rel=1e-12, abs=1e-300)
