"""Tables made smaller, against single precision through zstd."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import zstandard

import fitter
from tests.bench import tables
from tests.bench.measuring import Figure, Row, Size, alternate

SEED = 6
TOLERANCE = 0.01


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
