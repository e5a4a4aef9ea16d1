"""The coder of tokens under compressed tables, see :mod:`fitter.compression.entropy`.

Asymmetric numeral systems with the range of whole words (J. Duda 2013, "Asymmetric numeral systems",
arXiv:1311.2540; F. Giesen 2014, "Interleaved entropy coders", arXiv:1402.3392): tokens go to ``LANES`` states
in turn, which share one sequence of words, so that a processor works on several tokens at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part, routine
from fitter.kernels.range_coder import FIRST, PRECISION, WORD, Words

IntArray = NDArray[np.int64]
States = NDArray[np.uint64]

#: States that tokens go to in turn. Each costs a word and a half.
LANES = 4
_U = np.uint64
#: Where a state begins, and least it may be between two tokens.
START = np.uint64(1 << WORD)
_LOW = np.uint64((1 << PRECISION) - 1)


@compiled
def written(tokens: IntArray, rows: IntArray, ends: Words, words: Words) -> int:
    """Tokens of the distributions ``rows`` (n,) as the last words of ``words`` (n + 2 LANES,); how many.

    ends : of :func:`fitter.kernels.range_coder.cumulated`.
    """
    states = np.full(LANES, START)
    place = len(words)
    for k in range(len(tokens)):
        # The last one first: the decoder undoes step by step what is done here.
        j = len(tokens) - 1 - k
        lane = j % LANES
        left = _U(ends[rows[j], tokens[j]])
        wide = _U(ends[rows[j], tokens[j] + 1]) - left
        state = states[lane]
        if state >= wide << _U(2 * WORD - PRECISION):
            place -= 1
            words[place] = np.uint32(state & _U(0xFFFFFFFF))
            state >>= _U(WORD)
        states[lane] = ((state // wide) << _U(PRECISION)) + state % wide + left
    for lane in range(LANES - 1, -1, -1):
        place -= 2
        words[place] = np.uint32(states[lane] & _U(0xFFFFFFFF))
        words[place + 1] = np.uint32(states[lane] >> _U(WORD))
    return len(words) - place


@part
def opened(words: Words, states: States) -> int:
    """The states at the start of a message; the next word."""
    for lane in range(LANES):
        states[lane] = START
        if 2 * lane + 1 < len(words):
            states[lane] = (_U(words[2 * lane + 1]) << _U(WORD)) | _U(words[2 * lane])
    return 2 * LANES


@part
def ended(words: Words, states: States, place: int) -> bool:
    """Whether a message ends here: words of another one hardly bring all states back to their start."""
    same = place == max(len(words), 2 * LANES)
    for lane in range(LANES):
        same &= states[lane] == START
    return same


@routine
def read(
    rows: IntArray, count: int, turn: int, states: States, place: int, words: Words, ends: Words,
    first: NDArray[np.uint8], tokens: IntArray,
) -> int:  # fmt: skip
    """The next ``count`` tokens, of the distributions ``rows``; the next word.

    turn : how many came before. first : of :func:`fitter.kernels.range_coder.cumulated`.
    """
    for j in range(count):
        lane = (turn + j) & (LANES - 1)
        state, row = states[lane], rows[j]
        here = state & _LOW
        found = np.int64(first[row, np.int64(here >> _U(PRECISION - FIRST))])
        while _U(ends[row, found + 1]) <= here:
            found += 1
        left = _U(ends[row, found])
        state = (_U(ends[row, found + 1]) - left) * (state >> _U(PRECISION)) + here - left
        if state < START:
            state <<= _U(WORD)
            if place < len(words):
                state |= _U(words[place])
            place += 1
        states[lane] = state
        tokens[j] = found
    return place


@compiled
def message(
    words: Words, rows: IntArray, ends: Words, first: NDArray[np.uint8], tokens: IntArray
) -> bool:
    """Tokens of the distributions ``rows`` (n,) into ``tokens`` (n,); whether the message ends there."""
    states = np.empty(LANES, np.uint64)
    place = read(rows, len(rows), 0, states, opened(words, states), words, ends, first, tokens)
    return ended(words, states, place)
