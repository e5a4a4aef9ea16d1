"""Fits of a full table: warm against SciPy's least squares, and in a process of their own."""

from __future__ import annotations

import functools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

import fitter
from fitter import models
from fitter.models.pair import Pair
from fitter.table import Table
from tests.bench import plain, tables
from tests.bench.machine import ROOT
from tests.bench.measuring import Figure, Row, Size, alternate

FloatArray = NDArray[np.float64]
SEED = 1
FAMILIES = ("ward", "torrance_sparrow", "lafortune", "oren_nayar")
#: Lafortune's twelve parameters would take SciPy half a minute and a gigabyte.
AGAINST_SCIPY = ("ward", "torrance_sparrow", "oren_nayar")
#: MINPACK's Levenberg-Marquardt, and what least_squares takes by itself, which alone knows bounds.
METHODS = ("lm", "trf")
#: SciPy starts at the truth times this: it is spared the search that ours makes.
START = 1.3


def run(size: Size) -> Iterator[Row]:
    shape = size.pick(tables.MERL, tables.SMALL)
    for name in FAMILIES:
        yield _warm(name, tables.merl(name, shape, SEED), size)
    for name in FAMILIES:
        yield _growth(name, size)
    yield from _cold(tables.merl("ward", shape, SEED), size)


def _warm(name: str, table: Table, size: Size) -> Row:
    contenders: dict[str, Callable[[], Any]] = {
        "ours": lambda: fitter.fit(table, name, metric="cosine"),
        "default": lambda: fitter.fit(table, name),
        "sum": lambda: table.value.sum(),
    }
    if name in AGAINST_SCIPY:
        contenders |= {method: _scipy(name, table, method) for method in METHODS}
    times = alternate(contenders, size.pick(5, 2), once=frozenset(METHODS))
    fit: fitter.FitResult = times["ours"].result
    others = [
        times["default"].seconds("fitter.fit, default metric (cbrt)"),
        times["sum"].seconds("floor: NumPy summing the table"),
    ]
    facts: dict[str, Any] = {
        "samples": fit.cost["samples"], "channels": 3, "status": fit.status, "passes": fit.cost["passes"],
        "phases": fit.cost["phases"], "largest_error_in_u": _error(name, fit),
    }  # fmt: skip
    if name in AGAINST_SCIPY:
        others = [times[m].seconds(f"scipy least_squares, {m}, JAX Jacobian") for m in METHODS] + others
        facts["largest_difference_to_scipy"] = {
            m: max(float(np.abs(fit.parameters[k].value / v - 1.0).max()) for k, v in times[m].result.items())
            for m in METHODS
        }
    ours = times["ours"].seconds("fitter.fit, metric cosine")
    return Row(f"fit {name}, full table", ours, tuple(others), facts, SEED)


def _growth(name: str, size: Size) -> Row:
    """How the time of a fit grows with the samples: at the same samples a second it grows in proportion."""
    sizes = size.pick((10_000, 120_000, 1_500_000), (1_000, 4_000))
    given = {n: tables.scattered(name, n, SEED) for n in sizes}
    times = alternate(
        {str(n): functools.partial(fitter.fit, table, name, metric="cosine") for n, table in given.items()},
        size.pick(3, 1),
    )
    seconds = [float(np.median(times[str(n)].wall)) for n in sizes]
    *smaller, most = sizes
    table = given[most]
    held = table.value.nbytes + table.wi.nbytes + table.wo.nbytes
    facts: dict[str, Any] = {
        "samples": sizes, "seconds": seconds,
        "exponent": float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0]),
        "memory_growth_over_table": times[str(most)].result.cost["memory_growth_bytes"] / held,
    }
    return Row(
        case=f"fit {name}, scattered samples a second",
        ours=times[str(most)].rate(f"of {most:,}", most),
        others=tuple(times[str(n)].rate(f"of {n:,}", n) for n in smaller),
        facts=facts, seed=SEED,
    )  # fmt: skip


def _error(name: str, fit: fitter.FitResult) -> float:
    """Largest distance of a parameter from the truth, in standard uncertainties."""
    return max(
        float(np.max(np.abs(e.value - np.asarray(plain.TRUTHS[name][k])) / e.standard_uncertainty))
        for k, e in fit.parameters.items()
    )


def _scipy(name: str, table: Table, method: str) -> Callable[[], dict[str, FloatArray]]:
    """The same residuals, cos_i (f - y), in float64, over logarithms of the parameters; compiled here."""
    index = np.flatnonzero(table.mask)
    wi, wo = table.directions(index)
    pair, y = jnp.asarray(np.concatenate([wi.T, wo.T])), jnp.asarray(table.value[index])
    truth = {k: np.asarray(v, float) for k, v in plain.TRUTHS[name].items()}
    sizes = np.cumsum([v.size for v in truth.values()])

    def split(p: Any) -> dict[str, Any]:
        parts = jnp.split(jnp.exp(p), sizes[:-1])
        return {k: part.reshape(truth[k].shape) for k, part in zip(truth, parts, strict=True)}

    template = models.create(name, **truth)

    def residuals(p: Any, pair: Any, y: Any) -> Any:
        model = type(template)(spec=template.spec, channels=template.channels, values=split(p))
        return (pair[2][:, None] * (model.value(Pair(*pair)) - y)).reshape(-1)

    value, slope = jax.jit(residuals), jax.jit(jax.jacfwd(residuals))
    start = np.log(START * np.concatenate([v.reshape(-1) for v in truth.values()]))
    value(start, pair, y).block_until_ready()
    slope(start, pair, y).block_until_ready()

    def call() -> dict[str, FloatArray]:
        found = least_squares(
            lambda p: np.asarray(value(p, pair, y)), start, jac=lambda p: np.asarray(slope(p, pair, y)),
            method=method,
        )  # fmt: skip
        return {k: np.asarray(v) for k, v in split(found.x).items()}

    return call


def _cold(table: Table, size: Size) -> Iterator[Row]:
    """From starting Python to a file fitted twice: no compiled program kept, then the second process."""
    repeats = size.pick(3, 1)
    first: list[dict[str, float]] = []
    second: list[dict[str, float]] = []
    bare: list[float] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tables.write_merl(table, folder / "table.binary")
        for turn in range(repeats):
            run_cold = functools.partial(
                _process, "-m", "tests.bench.cold", str(folder / "table.binary"), str(folder / f"cache{turn}")
            )
            first.append(run_cold())
            second.append(run_cold())
            bare.append(_process("-c", "import jax, scipy.optimize; print('{}')")["process"])
    for label, laps in (("first process, nothing compiled yet", first), ("second process", second)):
        yield Row(
            case=f"load and fit ward twice, {label}",
            ours=Figure.of("import, load, fit twice, exit", "s", [lap["process"] for lap in laps]),
            others=(Figure.of("floor: importing JAX and SciPy", "s", bare),),
            facts={k: [lap[k] for lap in laps] for k in ("import", "load", "fit", "fit_again")},
            seed=SEED,
        )


def _process(*words: str) -> Mapping[str, float]:
    """What the process printed, and its seconds from start to exit."""
    began = time.perf_counter()
    done = subprocess.run([sys.executable, *words], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    return {**json.loads(done.stdout), "process": time.perf_counter() - began}
