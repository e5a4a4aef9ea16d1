"""Models evaluated at a million pairs: against NumPy, and against moving the bytes."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from fitter import models
from tests.bench import plain, tables
from tests.bench.measuring import Row, Size, alternate
from tests.bench.plain_canon import CANON, DEAR

SEED = 3


def run(size: Size) -> Iterator[Row]:
    exact = tables.pairs(size.pick(1_000_000, 20_000), SEED)
    for dtype in (np.float64, np.float32):
        for name, (function, truth) in _every().items():
            count = max(size.pick(1_000_000, 20_000) // DEAR.get(name, 1), 1000)
            wi, wo = (w[:count].astype(dtype) for w in exact)
            # What evaluation must at least do: read six numbers a pair and write three.
            moved = np.ones(9 * count // 2, dtype)
            out = np.empty_like(moved)
            model = models.create(name, **truth)
            contenders = {
                "ours": functools.partial(_ours, model, wi, wo),
                "numpy": functools.partial(plain.call, function, wi, wo, truth),
                "copy": functools.partial(np.copyto, out, moved),
            }
            times = alternate(contenders, size.pick(5, 2))
            ours, theirs = times["ours"].result, times["numpy"].result
            assert ours.dtype == theirs.dtype == dtype
            # Plain formulas lose digits at grazing and near the mirror direction: the median is agreement.
            difference = np.abs(ours - theirs) / np.maximum(np.abs(theirs), 1e-30)
            yield Row(
                case=f"evaluate {name}, {np.dtype(dtype).name}",
                ours=times["ours"].rate("model.evaluate", count),
                others=(
                    times["numpy"].rate("NumPy", count),
                    times["copy"].rate("floor: copying as many bytes", count),
                ),
                facts={
                    "pairs": count,
                    "channels": 3,
                    "median_relative_difference": float(np.median(difference)),
                    "largest_relative_difference": float(difference.max()),
                },
                seed=SEED,
            )


def _every() -> dict[str, tuple[Callable[..., plain.Array], Mapping[str, Any]]]:
    """Name -> (plain function, parameters)."""
    return {name: (function, plain.TRUTHS[name]) for name, function in plain.FUNCTIONS.items()} | CANON


def _ours(model: models.ReflectanceModel, wi: plain.Array, wo: plain.Array) -> plain.Array:
    return np.asarray(model.evaluate(wi, wo))
