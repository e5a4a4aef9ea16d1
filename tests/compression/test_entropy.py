"""Integers to bits and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter.compression import entropy
from fitter.compression.entropy import BitReader, Decoder, Distribution, Encoder

NUMBERS = st.lists(
    st.one_of(st.integers(-40, 40), st.integers(-entropy.LARGEST, entropy.LARGEST)), min_size=1, max_size=60
)


@given(NUMBERS)
def test_tokens_and_the_bits_after_them_are_the_numbers(given_: list[int]) -> None:
    numbers = np.array(given_, np.int64)
    token, bits, rest = entropy.tokens(numbers)
    assert token.max() < 256
    assert np.array_equal(entropy.bits_of(token), bits)
    packed = entropy.pack_bits(rest, bits)
    reader = BitReader(packed)
    half = len(numbers) // 2
    read = np.concatenate([reader.read(bits[:half]), reader.read(bits[half:])])
    assert np.array_equal(entropy.numbers(token, read, bits), numbers)
    with pytest.raises(ValueError, match="early"):
        reader.read(np.array([17]))


@given(groups=st.lists(st.tuples(NUMBERS, st.integers(0, 99)), max_size=5))
def test_the_coder_gives_back_its_tokens(groups: list[tuple[list[int], int]]) -> None:
    coder = Encoder()
    tokens, kinds = [], []
    for numbers, seed in groups:
        tokens.append(entropy.tokens(np.array(numbers, np.int64))[0])
        kinds.append(np.random.default_rng(seed).integers(0, 4, len(numbers)).astype(np.uint8))
        coder.write(tokens[-1], kinds[-1])
    distributions, words = coder.finish()
    decoder = Decoder(distributions, words)
    for token, kind in zip(tokens, kinds, strict=True):
        assert np.array_equal(decoder.read(kind), token)
    with pytest.raises(ValueError, match="no distribution"):
        decoder.read(np.array([9], np.uint8))


def test_every_distribution_can_code_every_token() -> None:
    for scale in range(0, 160, 11):
        for exponent in range(len(entropy.EXPONENTS)):
            for top in (0, 1, 40, 200):
                one = Distribution(scale, exponent, top)
                token = np.arange(top + 1)
                coder = entropy._stream.queue.RangeEncoder()
                for model in one.models:
                    coder.encode(token.astype(np.int32), model)
                decoder = Decoder({0: one}, coder.get_compressed())
                for shift in range(len(entropy.SHIFTS)):
                    assert np.array_equal(decoder.read(np.full(top + 1, shift, np.uint8)), token)


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
        assert spent < 1.02 * least + 16
