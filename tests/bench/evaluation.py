"""Models evaluated at a million pairs: against NumPy, and against moving the bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from fitter import models
from tests.bench import plain, tables
from tests.bench.measuring import Row, Size, alternate

SEED = 3


def run(size: Size) -> Iterator[Row]:
    count: int = size.pick(1_000_000, 20_000)
    exact = tables.pairs(count, SEED)
    for dtype in (np.float64, np.float32):
        wi, wo = (w.astype(dtype) for w in exact)
        # What evaluation must at least do: read six numbers a pair and write three.
        moved = np.ones(9 * count // 2, dtype)
        out = np.empty_like(moved)
        for name in plain.FUNCTIONS:
            model = models.create(name, **plain.TRUTHS[name])
            times = alternate(_contenders(name, model, wi, wo, moved, out), size.pick(5, 2))
            ours, theirs = times["ours"].result, times["numpy"].result
            assert ours.dtype == theirs.dtype == dtype
            difference = float(np.abs(ours / theirs - 1.0).max())
            yield Row(
                case=f"evaluate {name}, {np.dtype(dtype).name}",
                ours=times["ours"].rate("model.evaluate", count),
                others=(
                    times["numpy"].rate("NumPy", count),
                    times["copy"].rate("floor: copying as many bytes", count),
                ),
                facts={"pairs": count, "channels": 3, "largest_relative_difference": difference},
                seed=SEED,
            )


def _contenders(
    name: str, model: Any, wi: plain.Array, wo: plain.Array, moved: plain.Array, out: plain.Array
) -> dict[str, Callable[[], Any]]:
    return {
        "ours": lambda: np.asarray(model.evaluate(wi, wo)),
        "numpy": lambda: plain.evaluate(name, wi, wo),
        "copy": lambda: np.copyto(out, moved),
    }
