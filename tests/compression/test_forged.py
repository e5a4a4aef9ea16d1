"""Content that no encoder wrote, under checksums that fit, and tables at the ends of what there may be."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fitter import Table
from fitter.compression import CompressedTable, coding, compress, entropy, tile
from fitter.compression.archive import pack_parts, unpack_parts
from fitter.compression.container import Block
from fitter.compression.entropy import Encoder
from fitter.errors import TableError
from fitter.kernels.interleaved import LANES, message
from tests.compression import forged
from tests.compression.test_compression import scattered, smooth_grid


def test_forged_tiles_are_tiles_or_errors() -> None:
    found = list(forged.outcomes(3, 300))
    assert 0 < sum(found) < len(found)


@pytest.mark.long
def test_kernels_stay_within_their_arrays(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-m", "tests.compression.forged", "2", "900"],
        env=environment, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[1] == "900"


def test_random_words_are_read_to_the_end_of_the_rows() -> None:
    """Whatever the states: every distribution has a token for every point, and tables of them end at 2^24."""
    rng = np.random.default_rng(5)
    scales, exponents = np.arange(256), np.arange(len(entropy.EXPONENTS))
    for top in (0, 1, 2, 31, 247, 255):
        for exponent in exponents:
            rows = np.stack([scales, scales, np.full(256, exponent), np.full(256, top)], axis=1)
            _, ends, first = entropy.tables(rows.astype(np.uint8))
            used = min(max(2, top + 1), ends.shape[1] - 1)
            assert (np.diff(ends[:, : used + 1].astype(np.int64)) > 0).all()
            assert (ends[:, 0] == 0).all()
            assert (ends[:, used:] == 1 << 24).all()
            assert int(first.max()) < used
            words = rng.integers(0, 1 << 32, rng.integers(0, 300), dtype=np.uint32)
            drawn, token = rng.integers(0, len(ends), 2000), np.empty(2000, np.int64)
            assert not message(words, drawn, ends, first, token)
            assert ((token >= 0) & (token < used)).all()
    with pytest.raises(ValueError, match="more distributions"):
        entropy.tables(np.zeros((257, 4), np.uint8))


def test_no_tokens_and_one_symbol() -> None:
    for count in (0, 1, LANES - 1, 1000):
        coder = Encoder()
        coder.write(np.zeros(count, np.int64), np.zeros(count, np.uint8))
        distributions, words = coder.finish()
        assert len(distributions) == min(count, 1)
        _, ends, first = entropy.tables(distributions)
        found = np.ones(count, np.int64)
        assert message(words, np.zeros(count, np.int64), ends, first, found)
        assert not found.any()
        assert len(words) <= 2 * LANES + 1


@pytest.mark.parametrize("shape", forged.SHAPES)
@pytest.mark.parametrize("gaps", ["none", "all", "half"])
def test_tiles_of_every_shape(shape: tuple[int, ...], gaps: str) -> None:
    rng = np.random.default_rng(len(shape))
    for size in (0.0, 3.0, 1e5):
        steps = rng.normal(0, size, shape)
        steps[rng.random(shape) < {"none": -1, "all": 2, "half": 0.5}[gaps]] = np.nan
        there = np.isfinite(steps)
        _, back = tile.encode(steps)
        assert np.abs(back - steps)[there].max(initial=0.0) < 0.51


def test_tables_of_one_usable_value() -> None:
    """One at least there has to be."""
    for rest in ([], [np.nan] * 5, [np.inf, -np.inf, np.nan]):
        table = scattered(np.array([0.5, *rest]))
        small = compress(table, 0.01, floor=1e-3)
        back = CompressedTable.from_bytes(small.to_bytes()).decompress()
        assert np.array_equal(back.value[1:], table.value[1:], equal_nan=True)
        assert abs(back.value[0, 0] - 0.5) <= 0.01 * 0.501
        assert np.array_equal(back.mask, table.mask)


def replaced(small: CompressedTable, name: str, part: int, data: bytes) -> CompressedTable:
    """With one of the parts of a block replaced, its checksum that of the new content."""
    block = small.blocks[name]
    parts = unpack_parts(block.data, 7)
    parts[part] = data
    new = Block(name, pack_parts(parts), block.about)
    return CompressedTable.from_bytes(CompressedTable(small.header, {**small.blocks, name: new}).to_bytes())


def test_content_that_makes_no_sense_names_its_block_and_leaves_the_others() -> None:
    small = compress(smooth_grid((9, 12, 20), channels=2), 0.01, tile=700)
    name, whole = "values 2", small.decompress().value
    box = coding.place(small.blocks[name], small.tiles.folds)
    inside = np.zeros((9, 12, 20), bool)
    inside[box.slices] = True
    rng = np.random.default_rng(6)
    places = coding._sparse(np.array([0]))
    far = coding._sparse(np.array([len(whole) * 2]))
    other = coding._sparse(np.array([2 * int(np.flatnonzero(~inside.reshape(-1))[0])]))
    value = coding._sparse(np.array([1.0]))
    coded = unpack_parts(unpack_parts(small.blocks[name].data, 7)[0], 5)
    cut = pack_parts([*coded[:4], coded[4][:-8]])
    forgeries: list[tuple[dict[int, bytes], str]] = [
        ({0: rng.bytes(500)}, "can't be unpacked"),
        ({0: cut}, "end"),
        ({1: b"\0"}, "elsewhere than its words"),
        ({5: far, 6: value}, "can't be unpacked"),
        ({5: other, 6: value}, "another tile"),
        ({5: places}, "as many as their places"),
        ({3: places}, "as many as their places"),
    ]
    for parts, message_ in forgeries:
        bad = small
        for part, data in parts.items():
            bad = replaced(bad, name, part, data)
        with pytest.raises(TableError, match=message_) as caught:
            bad.decompress()
        assert caught.value.column == name
        rest = np.flatnonzero(~inside.reshape(-1))
        assert np.array_equal(bad.values(rest), whole[rest])


@pytest.mark.parametrize("start", [None, "x", [0], [-1, 0, 0], [9, 0, 0], [1 << 70, 0, 0], [[0], 0, 0]])
def test_a_tile_that_is_nowhere(start: Any) -> None:
    small = compress(smooth_grid((9, 12, 20)), 0.01)
    block = small.blocks["values 0"]
    small.blocks["values 0"] = Block(block.name, block.data, {**block.about, "start": start})
    for read in (small.decompress, lambda: small.values([0])):
        with pytest.raises(TableError, match=r"'values 0'.*no tile"):
            read()


def test_a_kernel_that_cant_be_compiled_is_no_damage(monkeypatch: pytest.MonkeyPatch) -> None:
    small = compress(smooth_grid((3, 4, 5)), 0.01)
    for kind in (KeyError, TypeError, IndexError):

        def fails(*_: object, kind: type[Exception] = kind) -> None:
            raise kind("no such type")

        monkeypatch.setattr("fitter.kernels.tiles.decoded", fails)
        with pytest.raises(kind):
            small.decompress()


def test_a_tile_of_a_part_is_no_whole() -> None:
    """What it does not cover is lost, and said to be."""
    half, whole = (
        compress(Table(wi=w, wo=w, value=1.0 + w[:, :1]), 0.01) for w in (_up(150), _up(300))
    )
    block = half.blocks["values 0"]
    whole.blocks["values 0"] = Block(block.name, block.data, {**block.about, "start": [0], "stop": [150]})
    value, lost = whole.tiles.all()
    assert lost.tolist() == [False] * 150 + [True] * 150
    assert np.isfinite(value[:150]).all()
    assert np.isnan(value[150:]).all()


def _up(n: int) -> np.ndarray:
    theta = np.linspace(0.1, 1.2, n)
    return np.stack([np.sin(theta), np.zeros(n), np.cos(theta)], axis=1)
