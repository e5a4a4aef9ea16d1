"""Tables made smaller: beside other error-bounded compressors, and how long it takes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import zstandard
from numpy.typing import NDArray

import fitter
from fitter.compression.arrangement import shape_of
from tests.bench import compressors, tables
from tests.bench.dense_tables import SEED as TRACED
from tests.bench.dense_tables import Dense, dense
from tests.bench.measuring import Figure, Row, Size, alternate

FloatArray = NDArray[np.float64]
SEED = 6
TOLERANCE = 0.01
TOLERANCES = (0.001, 0.01, 0.05)


def run(size: Size) -> Iterator[Row]:
    table = tables.merl("ward", size.pick(tables.MERL, tables.SMALL), SEED)

    def pack() -> bytes:
        return zstandard.ZstdCompressor(level=3).compress(table.value.astype(np.float32).tobytes())

    small = fitter.compress(table, TOLERANCE)
    packed = pack()
    times = alternate(
        {
            "ours": lambda: fitter.compress(table, TOLERANCE),
            "zstd": pack,
            "open": small.decompress,
            "unzstd": lambda: np.frombuffer(zstandard.ZstdDecompressor().decompress(packed), np.float32),
        },
        size.pick(3, 2),
    )
    facts = {"tolerance": TOLERANCE, "noise": 0.01, "bytes": small.nbytes, "worst_error": small.worst_error}
    zstd = "float32 + zstd"
    yield Row(
        case="compress a MERL grid to 1 %: size, float64 bytes over ours",
        ours=Figure.of("fitter.compress", "ratio", [small.ratio]),
        others=(Figure.of(zstd, "ratio", [table.value.nbytes / len(packed)]),),
        facts=facts, seed=SEED,
    )  # fmt: skip
    for case, key, name, other in (
        ("compress a MERL grid to 1 %", "ours", "fitter.compress", "zstd"),
        ("decompress it", "open", "CompressedTable.decompress", "unzstd"),
    ):
        yield Row(case, times[key].seconds(name), (times[other].seconds(zstd),), facts, SEED)
    advantages: list[float] = []
    for one in dense(size):
        for tolerance in TOLERANCES:
            rows = list(_beside(one, tolerance, size))
            best = min(rows[0].ours.median / other.median for other in rows[0].others[:-1])
            advantages.append(best)
            yield from rows
    yield Row(
        case="all of these tables and tolerances: size, geometric mean over the best other one of each",
        ours=Figure.of("fitter.compress", "ratio", [float(np.exp(np.mean(np.log(advantages))))]),
        others=(Figure.of("the best of the others", "ratio", [1.0]),),
        facts={"least_advantage": min(advantages), "missing": compressors.missing()},
    )  # fmt: skip


def _beside(one: Dense, tolerance: float, size: Size) -> Iterator[Row]:
    """One table at one tolerance: bytes of the values alone, and unpacking them."""
    small = fitter.compress(one.table, tolerance)
    absent = compressors.missing()
    value, shape = one.table.value, shape_of(one.table)
    others = {
        name: compressors.smallest(name, value, shape, tolerance, small.floor)
        for name in compressors.NAMES
        if name not in absent
    }
    finite = np.isfinite(value)
    for name, packed in others.items():
        error = np.abs(packed.unpack() - value) / (tolerance * (np.abs(value) + small.floor))
        if not (error[finite] <= 1 + 1e-6).all():
            raise AssertionError(f"{name} does not keep the bound on {one.name}")
    case = f"{one.name}, {100 * tolerance:g} %"
    plain = value.nbytes
    least = noise_bytes(value, one.sigma, tolerance, small.floor)
    facts = {
        "tolerance": tolerance, "floor": small.floor.tolist(), "bytes": small.value_bytes,
        "file_bytes": small.nbytes, "worst_error": small.worst_error,
        "mean_error": small.mean_error.tolist(), "rms_error": small.rms_error.tolist(),
        "noise_entropy_bytes": least, "missing": absent,
        "others": {name: {"bytes": packed.size, "how": packed.how} for name, packed in others.items()},
    }  # fmt: skip
    yield Row(
        case=f"{case}: size, float64 bytes over ours",
        ours=Figure.of("fitter.compress", "ratio", [plain / small.value_bytes]),
        others=(
            *(Figure.of(name, "ratio", [plain / packed.size]) for name, packed in others.items()),
            Figure.of("entropy of independent noise", "ratio", [plain / max(least, 1.0)]),
        ),
        facts=facts, seed=TRACED,
    )  # fmt: skip
    if tolerance != TOLERANCE:
        return
    unpack = {name: packed.unpack for name, packed in others.items()}
    times = alternate({"ours": small.tiles.all, **unpack}, size.pick(5, 1))
    yield Row(
        case=f"{case}: unpack",
        ours=times["ours"].seconds("Tiles.all"),
        others=tuple(times[name].seconds(name) for name in others),
        facts=facts, seed=TRACED,
    )  # fmt: skip


def noise_bytes(value: FloatArray, sigma: FloatArray, tolerance: float, floor: FloatArray) -> float:
    """Bytes that normal noise of this sigma, independent from value to value, costs in steps of the bound.

    No code of all values can be shorter on average where the noise is that; where the noise is shared by
    channels, or stated too large, one may be.
    """
    finite = np.isfinite(value) & np.isfinite(sigma)
    width = (sigma / (2 * tolerance * (np.abs(value) + floor)))[finite]
    at = np.geomspace(1e-3, 1e6, 400)
    return float(np.interp(np.log(np.maximum(width, 1e-3)), np.log(at), [_entropy(w) for w in at]).sum() / 8)


def _entropy(width: float) -> float:
    """Bits of a normal number of this standard deviation, rounded to a whole one."""
    from scipy.special import ndtr

    if width > 30:
        return float(np.log2(width * np.sqrt(2 * np.pi * np.e)))
    k = np.arange(-400, 401)
    p = ndtr((k + 0.5) / width) - ndtr((k - 0.5) / width)
    p = p[p > 0]
    return float(-(p * np.log2(p)).sum())
