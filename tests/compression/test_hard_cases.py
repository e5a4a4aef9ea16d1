"""The rows of docs/hard-cases.md about compression: a naive form shown wrong, ours right."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
import zstandard

from fitter.compression import CompressedTable, compress
from fitter.compression.archive import pack_parts
from fitter.compression.container import Block
from fitter.errors import TableError
from fitter.table import Table
from tests.compression.test_compression import scattered, smooth_grid, within


def test_k01() -> None:
    value = np.array([0.0, 1e-3, -1e-3, 1.0])
    with np.errstate(all="ignore"):
        assert not np.isfinite(np.log(value)).all()
    table = scattered(value)
    small = compress(table, 0.01)
    back = small.decompress().value
    assert within(table.value, back, 0.01, small.floor)
    assert back[0, 0] == 0.0


def test_k02() -> None:
    value = np.array([1.7e308, 1e-300, 5.0])
    with np.errstate(over="ignore"):
        assert np.isinf(value / 1e-300).any()
    table = scattered(value)
    small = compress(table, 0.01, floor=1e-300)
    assert within(table.value, small.decompress().value, 0.01, small.floor)


def test_k03() -> None:
    """Halves that mirror each other everywhere but in a few nodes."""
    table = smooth_grid((6, 10, 20), noise=0.02)
    cube = table.value.reshape(6, 10, 20)
    cube = 0.5 * (cube + cube[..., ::-1])
    cube[2, 3, 15] *= 1.5
    table = Table(value=cube.reshape(-1), grid=table.grid)
    naive = np.concatenate([cube[..., :10], cube[..., 9::-1]], axis=2)
    assert np.abs(naive / cube - 1).max() > 0.3
    small = compress(table, 0.01)
    assert small.tiles.folds.mirrored == (2,)
    assert within(table.value, small.decompress().value, 0.01, small.floor)


def test_k04() -> None:
    """A missing value in a smooth table costs its neighbours nothing."""
    table = smooth_grid((6, 10, 20), noise=0.0)
    value = table.value.copy()
    value[::7] = np.nan
    cube = value.reshape(6, 10, 20)
    naive = 0.5 * (cube[..., :-2] + cube[..., 2:])
    assert np.isnan(naive[np.isfinite(cube[..., 1:-1])]).any()
    holed = Table(value=value, grid=table.grid)
    small = compress(holed, 0.01)
    back = small.decompress().value
    assert within(holed.value, back, 0.01, small.floor)
    assert np.array_equal(np.isnan(back), np.isnan(value))


def test_k05() -> None:
    """A table smoother than its bound: rounded to one lattice, whole plateaus are off to one side."""
    table = smooth_grid((20, 24, 30), noise=0.001)
    small = compress(table, 0.05)
    step = 2 * np.log1p(0.05)
    y = np.log1p(table.value / small.floor)
    naive = (np.rint(y / step) * step - y) / np.log1p(0.05)
    assert abs(naive.mean()) > 0.1
    assert np.abs(small.mean_error).max() < 0.02


def test_k06() -> None:
    """One changed byte, one long stream: all that follows is lost. In tiles it is one of them."""
    table = smooth_grid((9, 12, 20))
    stream = bytearray(zstandard.ZstdCompressor().compress(table.value.tobytes()))
    stream[len(stream) // 2] ^= 0xFF
    decoder = zstandard.ZstdDecompressor().decompressobj()
    try:
        left = decoder.decompress(bytes(stream))
    except zstandard.ZstdError:
        left = b""
    assert left != table.value.tobytes()
    small = compress(table, 0.0, tile=300)
    data = bytearray(small.to_bytes())
    data[bytes(data).index(small.blocks["values 3"].data) + 9] ^= 0xFF
    kept = CompressedTable.from_bytes(bytes(data), damage="keep").decompress()
    same = (kept.value == table.value).all(axis=1)
    assert same.sum() > 0.8 * len(table)


def test_k07() -> None:
    """A forged length, with a checksum that fits it."""
    forged = zstandard.ZstdCompressor().compress(b"x" * 64)
    header = bytearray(forged)
    frame = zstandard.get_frame_parameters(bytes(header))
    assert frame.content_size == 64
    # A frame that claims 2^60 bytes: single segment, eight bytes of content size.
    claimed = b"\x28\xb5\x2f\xfd" + bytes([0b11100000]) + struct.pack("<Q", 1 << 60) + b"\x01\x00\x00"
    small = compress(smooth_grid((3, 4, 5)), 0.01)
    block = small.blocks["mask"]
    bad = CompressedTable(small.header, {**small.blocks, "mask": Block("mask", claimed, block.about)})
    again = CompressedTable.from_bytes(bad.to_bytes())
    assert zlib.crc32(again.blocks["mask"].data) == zlib.crc32(claimed)
    with pytest.raises(TableError, match="'mask'"):
        again.decompress()
    values = Block("values 0", pack_parts([b"f"] + 6 * [b""]), small.blocks["values 0"].about)
    with pytest.raises(TableError, match="'values 0'"):
        CompressedTable(small.header, {**small.blocks, "values 0": values}).values([0])
