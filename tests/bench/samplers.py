"""Directions drawn from raw tables and from models, against simpler ways to draw them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import fitter
from fitter import models
from fitter.directions import vector_from_spherical
from fitter.sampling import moment
from fitter.table import Table
from tests.bench import plain, tables
from tests.bench.measuring import Figure, Row, Size, Times, alternate
from tests.bench.memory import peak
from tests.sampling.tables import adaptive, merl, scattered, spherical

FloatArray = NDArray[np.float64]
SEED = 5
WI = np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5)])


def run(size: Size) -> Iterator[Row]:
    for alpha in (0.05, 0.15):
        yield from _table(alpha, size)
    yield from _slices(size)
    yield _stream(size)
    yield _model(size)


def _table(alpha: float, size: Size) -> Iterator[Row]:
    n: int = size.pick(1_000_000, 20_000)
    tried: int = size.pick(262_144, 20_000)
    table = merl(alpha, shape=size.pick(tables.MERL, tables.SMALL))
    rng = np.random.default_rng(SEED)
    # The tightest bound there is, the slice's own maximum, is given to the cosine envelope for nothing.
    bound = float(table.evaluate(*_cosine(rng, tried))[0].max())
    kept = fitter.TableSampler(table)
    times = alternate(
        {
            "ours": lambda: fitter.TableSampler(table).sample(WI, n, seed=SEED),
            "kept": lambda: kept.sample(WI, n, seed=SEED),
            "cosine": lambda: _rejected(table, bound, rng, tried),
            "uniforms": lambda: rng.random(3 * n),
        },
        size.pick(3, 2),
    )
    accepted = times["cosine"].result / tried
    shares = {"acceptance": times["ours"].result.acceptance, "cosine_acceptance": accepted, "draws": n}
    others = (
        times["cosine"].rate("cosine envelope, same interpolant", times["cosine"].result),
        times["uniforms"].rate("floor: NumPy drawing three uniforms each", n),
    )
    name = f"draws from a GGX table, alpha {alpha:g}, 45 deg"
    for label, key in (("set-up included", "ours"), ("set-up kept", "kept")):
        yield Row(f"{name}, {label}", times[key].rate("TableSampler.sample", n), others, shares, SEED)
    yield Row(
        case=f"{name}: share of candidates accepted",
        ours=Figure.of("TableSampler", "ratio", [shares["acceptance"]]),
        others=(Figure.of("cosine envelope", "ratio", [accepted]),),
        seed=SEED,
    )


def _slices(size: Size) -> Iterator[Row]:
    """Two-dimensional slices, set-up of the slice included, beside the triples of uniform numbers alone."""
    n: int = size.pick(1_000_000, 20_000)
    grid = spherical(0.15, *size.pick((90, 91), (30, 31)))
    in_out = Table(value=grid.value[:, 0], grid=grid.grid)
    scans = scattered(0.15)
    rng = np.random.default_rng(SEED)
    merl_grid = merl(0.15, shape=size.pick((90, 90, 180), (20, 18, 36)))
    for name, table, wi, method in (
        ("a half/difference grid", merl_grid, WI, "rejection"),
        ("an adaptive table, three channels", adaptive(), vector_from_spherical(0.6, 0.3), "rejection"),
        ("an in/out grid", in_out, WI, "rejection"), ("an in/out grid", in_out, WI, "inversion"),
        ("a scattered scan", scans, scans.wi[0], "inversion"),
        ("a scattered scan", scans, scans.wi[0], "rejection"),
    ):  # fmt: skip
        times = alternate(
            {
                "ours": lambda t=table, w=wi, m=method: fitter.TableSampler(t, method=m).sample(
                    w, n, seed=SEED
                ),
                "uniforms": lambda: rng.random((n, 3)),
            },
            size.pick(9, 2),
        )
        yield Row(
            f"draws from a slice of {name} by {method}, set-up included",
            times["ours"].rate("TableSampler.sample", n),
            (times["uniforms"].rate("floor: NumPy drawing three uniforms each", n),),
            {"acceptance": times["ours"].result.acceptance, "draws": n}, SEED,
        )  # fmt: skip


_STREAM = """
import numpy as np
import fitter
from fitter.sampling import moment
from tests.sampling.tables import spherical
sampler = fitter.TableSampler(spherical(0.15, 60, 61))
wi = np.array([0.5**0.5, 0.0, 0.5**0.5])
sampler.info(wi)
"""


def _stream(size: Size) -> Row:
    """Memory of a stream, and how far its mean is from the integral, in standard errors."""
    n: int = size.pick(100_000_000, 200_000)
    began = time.perf_counter()
    needed = peak(_STREAM, f"moment(sampler.stream(wi, {n}, {SEED}), lambda wo: wo[:, 2])", Path("unused"))
    seconds = time.perf_counter() - began
    table = spherical(0.15, 60, 61)
    sampler = fitter.TableSampler(table)
    found = moment(sampler.stream(WI, n, SEED), lambda wo: wo[:, 2])
    # The same integral by a plain sum over the disk.
    u, phi = (np.arange(4000) + 0.5) / 4000, (np.arange(1440) + 0.5) / 1440 * 2 * np.pi
    exact = np.zeros(2)
    for x in u:
        r, z = np.sqrt(x), np.sqrt(1 - x)
        wo = np.stack([r * np.cos(phi), r * np.sin(phi), np.full_like(phi, z)], axis=1)
        exact += table.evaluate(WI, wo)[0].mean(axis=0) * z * np.pi / len(u)
    return Row(
        case=f"a stream of {n:,} draws and a moment of them",
        ours=Figure.of("TableSampler.stream", "s", [seconds]),
        facts={
            "peak_bytes": needed, "draws": n, "moment": found.value.tolist(), "by_sum": exact.tolist(),
            "standard_error": found.standard_error.tolist(),
        },
        seed=SEED,
    )  # fmt: skip


def _rejected(table: Table, bound: float, rng: np.random.Generator, tried: int) -> int:
    """How many of ``tried`` cosine-distributed candidates are accepted."""
    wi, wo = _cosine(rng, tried)
    value, _ = table.evaluate(wi, wo)
    return int((rng.random(tried) * bound < value[:, 0]).sum())


def _cosine(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    u, phi = rng.random(count), rng.uniform(0, 2 * np.pi, count)
    r = np.sqrt(u)
    wo = np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1.0 - u)], axis=1)
    return np.broadcast_to(WI, wo.shape), wo


def _model(size: Size) -> Row:
    n: int = size.pick(1_000_000, 20_000)
    name = "torrance_sparrow:ggx:smith"
    model = models.create(name, **plain.TRUTHS[name])
    rng = np.random.default_rng(SEED)
    times: dict[str, Times] = alternate(
        {
            "ours": lambda: model.sample(WI, n, seed=SEED),
            "numpy": lambda: _numpy_sample(rng, n),
            "uniforms": lambda: rng.random(3 * n),
        },
        size.pick(5, 2),
    )
    mean, plainly = times["ours"].result.weight.mean(axis=0), times["numpy"].result.mean(axis=0)
    return Row(
        case=f"draws from the model {name}, with pdf and weight",
        ours=times["ours"].rate("model.sample", n),
        others=(
            times["numpy"].rate("NumPy, same mixture", n),
            times["uniforms"].rate("floor: NumPy drawing three uniforms each", n),
        ),
        facts={"draws": n, "albedo": mean.tolist(), "numpy_albedo": plainly.tolist()},
        seed=SEED,
    )


def _numpy_sample(rng: np.random.Generator, n: int) -> FloatArray:
    """Weights (n, 3) of draws from half GGX half vectors, half a cosine lobe."""
    values = plain.TRUTHS["torrance_sparrow:ggx:smith"]
    alpha: float = values["alpha"]
    u, phi, choice = rng.random(n), 2 * np.pi * rng.random(n), rng.random(n) < 0.5
    tan2 = alpha**2 * u / (1.0 - u)
    cos_h = 1.0 / np.sqrt(1.0 + tan2)
    sin_h = np.sqrt(tan2) * cos_h
    h = np.stack([sin_h * np.cos(phi), sin_h * np.sin(phi), cos_h], axis=1)
    r = np.sqrt(u)
    diffuse = np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1.0 - u)], axis=1)
    wo = np.where(choice[:, None], 2.0 * (h @ WI)[:, None] * h - WI, diffuse)
    half = wo + WI
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    ggx = alpha**2 / (np.pi * (half[:, 2] ** 2 * (alpha**2 - 1.0) + 1.0) ** 2)
    pdf = 0.5 * ggx * np.abs(half[:, 2]) / (4.0 * np.abs(half @ WI)) + 0.5 * np.maximum(wo[:, 2], 0.0) / np.pi
    value = plain.evaluate("torrance_sparrow:ggx:smith", np.broadcast_to(WI, wo.shape), wo)
    return value * (np.maximum(wo[:, 2], 0.0) / pdf)[:, None]
