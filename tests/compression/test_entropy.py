"""Integers to bits and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter.compression import entropy, tile
from fitter.compression.archive import pack_parts, unpack_parts
from fitter.compression.entropy import Encoder
from fitter.kernels.interleaved import LANES, message, written
from fitter.kernels.range_coder import read

NUMBERS = st.lists(
    st.one_of(st.integers(-40, 40), st.integers(-entropy.LARGEST, entropy.LARGEST)), min_size=1, max_size=60
)


def read_back(distributions: np.ndarray, words: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """The tokens of a message, by the decoder's kernels."""
    which, ends, first = entropy.tables(distributions)
    found = np.empty(len(kinds), np.int64)
    shifts = len(entropy.SHIFTS)
    assert message(words, which[kinds // shifts] * shifts + kinds % shifts, ends, first, found)
    return found


@given(NUMBERS)
def test_tokens_and_the_bits_after_them_are_the_numbers(given_: list[int]) -> None:
    numbers = np.array(given_, np.int64)
    token, bits, rest = entropy.tokens(numbers)
    assert token.max() < 256
    packed = np.unpackbits(entropy.pack_bits(rest, bits), bitorder="little")
    ends = np.cumsum(bits)
    for number, t, count, end in zip(numbers, token, bits, ends, strict=True):
        tail = int((packed[end - count : end].astype(np.int64) << np.arange(count)).sum())
        part = (int(t) - entropy.DIRECT) % (1 << entropy.MANTISSA)
        folded = int(t) if t < entropy.DIRECT else ((1 << entropy.MANTISSA) + part << int(count)) | tail
        assert (folded >> 1) ^ -(folded & 1) == number


@given(groups=st.lists(st.tuples(NUMBERS, st.integers(0, 99)), max_size=5))
def test_the_coder_gives_back_its_tokens(groups: list[tuple[list[int], int]]) -> None:
    coder = Encoder()
    tokens, kinds = [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)]
    for numbers, seed in groups:
        token = entropy.tokens(np.array(numbers, np.int64))[0]
        kind = np.random.default_rng(seed).integers(0, 4, len(numbers)).astype(np.uint8)
        coder.write(token, kind)
        tokens.append(token)
        kinds.append(kind)
    distributions, words = coder.finish()
    assert np.array_equal(read_back(distributions, words, np.concatenate(kinds)), np.concatenate(tokens))


def test_every_distribution_can_code_every_token() -> None:
    """For every exponent and scales from narrow to wide; a message whose words were changed does not end."""
    shifts = len(entropy.SHIFTS)
    for scale in range(0, 160, 11):
        for exponent in range(len(entropy.EXPONENTS)):
            for top in (0, 1, 40, 200):
                _, ends, first = entropy.tables(np.array([[0, scale, exponent, top]], np.uint8))
                token = np.tile(np.arange(top + 1), shifts)
                rows = np.repeat(np.arange(shifts), top + 1)
                words = np.empty(len(token) + 2 * LANES, np.uint32)
                words = words[len(words) - written(token, rows, ends, words) :]
                found = np.empty(len(token), np.int64)
                assert message(words, rows, ends, first, found)
                assert np.array_equal(found, token)
                words[-1] ^= 1
                assert not message(words, rows, ends, first, found)


def test_data_that_no_encoder_wrote_has_no_token() -> None:
    which, ends, first = entropy.tables(np.array([[0, 40, 0, 3]], np.uint8))
    assert list(which[:2]) == [0, -1]
    found = np.empty(1, np.int64)
    assert not read(np.full(2, 0xFFFFFFFF, np.uint32), ends, first, np.zeros(1, np.int64), found)
    with pytest.raises(ValueError, match="exponent"):
        entropy.tables(np.array([[0, 40, 99, 3]], np.uint8))


def test_bits_are_near_the_entropy() -> None:
    """Of normal and of heavy-tailed numbers, within 2 % of what their histogram would allow at best."""
    rng = np.random.default_rng(0)
    normal, heavy = rng.standard_normal(40_000), rng.standard_t(3, 40_000)
    for drawn in (3.0 * normal, 0.2 * normal, heavy):
        token, bits, rest = entropy.tokens(np.rint(drawn).astype(np.int64))
        coder = Encoder()
        coder.write(token, np.zeros(len(token), np.uint8))
        _, words = coder.finish()
        spent = words.nbytes + len(entropy.pack_bits(rest, bits))
        _, count = np.unique(np.rint(drawn), return_counts=True)
        least = -(count * np.log2(count / len(drawn))).sum() / 8
        # The states that the decoder begins with are written whole, 8 bytes each. What of that the first
        # tokens pay for (half a word a lane on average) is left as a margin.
        assert spent < 1.02 * least + 8 * LANES


def test_tiles_that_no_encoder_wrote() -> None:
    """Any bytes with the right lengths are a tile or a ValueError: the kernel checks what it reads."""
    rng = np.random.default_rng(4)
    steps = rng.normal(0, 30, (2, 9, 6, 5)).cumsum(axis=1)
    data, decoded = tile.encode(steps)
    assert np.array_equal(tile.decode(data, steps.shape, None), decoded)
    parts = unpack_parts(data, 5)
    failed = 0
    for trial in range(400):
        broken = [bytearray(part) for part in parts]
        which = broken[1 + trial % 4]
        for place in rng.integers(0, len(which), 1 + trial % 3) if which else ():
            which[place] = rng.integers(256)
        if trial % 7 == 0:
            del which[len(which) // 2 // 4 * 4 :]
        try:
            found = tile.decode(pack_parts([bytes(part) for part in broken]), steps.shape, None)
        except ValueError:
            failed += 1
        else:
            assert found.shape == steps.shape
    assert 20 < failed < 400
