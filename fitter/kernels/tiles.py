"""Decoding a tile of a compressed table: what :mod:`fitter.compression.tile` says, channel by channel of each
stage.

The numbers have to be the encoder's to the last bit: operations and their order are those of the array
operations of :mod:`fitter.compression.stages` and :mod:`fitter.compression.rules`, in the tile's own type.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, interleaved, part, range_coder, routine
from fitter.kernels.range_coder import Reader, Words
from fitter.kernels.stages import BLOCK, SCRATCH, IntArray, Numbers, dithered, inside, mixed, paired, woven

Bytes = NDArray[np.uint8]

#: What a tile may be wrong in; 0 is nothing.
RULES_END, NO_RULE, NO_DISTRIBUTION, NO_TOKEN, BITS_END, WORDS_END = 1, 2, 3, 4, 5, 6


@part
def width_of(code: int) -> float:
    """The weight that a byte is, see ``fitter.compression.rules``."""
    return (8 + (code & 7)) / 16.0 * 2.0 ** ((code >> 3) - 23)


@routine
def classed(width: Numbers, added: Numbers, narrowest: int, kinds: Bytes) -> None:
    """Class and shift of each number, as ``fitter.compression`` has them."""
    # The exponent and the first bit of the mantissa: in double precision they are in the upper of two words.
    bits = width.view(np.int32)
    apart = len(bits) // len(width)
    shift, zero = (22, (127 + narrowest) << 1) if apart == 1 else (19, (1023 + narrowest) << 1)
    for i in range(len(width)):
        half = (np.int64(bits[apart * i + apart - 1]) >> shift) - zero
        kinds[i] = min(max(half, 0), 47) * 4 + np.int64(abs(added[i]) * width.dtype.type(8))


@routine
def corrected(
    values: IntArray, here: NDArray[np.bool_], added: Numbers, predicted: Numbers, width: Numbers,
    corrections: Numbers, new: Numbers, missed: Numbers,
) -> None:  # fmt: skip
    """What numbers of steps make of predictions: corrections, known nodes, and what those say of the errors
    to come."""
    kind = width.dtype.type
    for i in range(np.uint64(len(here))):
        value = kind(values[i])
        correction = (-value if added[i] < 0 else value) - added[i]
        correction = correction if here[i] else kind(0)
        corrections[i] = correction
        new[i] = predicted[i] + correction
        missed[i] = abs(correction) * kind(0.6) + width[i] * kind(0.4)


@part
def numbered(tokens: IntArray, count: int, packed: Bytes, bit: int, available: int) -> int:
    """Tokens as the numbers that they and the bits from ``bit`` on are; the next bit, -1 where they end."""
    for j in range(count):
        t = tokens[j]
        value = t
        if t >= 32:
            more = ((t - 32) >> 3) + 2
            if bit + more > available:
                return -1
            p, some = bit >> 3, np.int64(0)
            for k in range(5):  # at most 28 bits, from any of the first 8
                some |= np.int64(packed[p + k]) << (8 * k)
            value = ((8 + ((t - 32) & 7)) << more) | ((some >> (bit & 7)) & ((1 << more) - 1))
            bit += more
        tokens[j] = (value >> 1) ^ -(value & 1)
    return bit


@routine
def ordered(
    kinds: Bytes, here: NDArray[np.bool_], order: IntArray, tokens: IntArray, reader: Reader, words: Words,
    which: IntArray, ends: Words, first: Bytes,
) -> tuple[int, Reader]:  # fmt: skip
    """Tokens of one group, kind by kind, to their places, as version 2 has them; what is wrong."""
    begin = np.zeros(257, np.int64)
    for i in range(len(kinds)):
        if here[i]:
            begin[np.int64(kinds[i]) + 1] += 1
    for k in range(256):
        begin[k + 1] += begin[k]
    place = begin[:256].copy()
    for i in range(len(kinds)):
        if here[i]:
            k = np.int64(kinds[i])
            order[place[k]] = i
            place[k] += 1
    for k in range(256):
        if begin[k + 1] > begin[k]:
            own = which[k >> 2]
            if own < 0:
                return NO_DISTRIBUTION, reader
            row = own * 4 + (k & 3)
            for j in range(begin[k], begin[k + 1]):
                t, reader = range_coder.token(reader, words, ends, first, row)
                if t < 0:
                    return NO_TOKEN, reader
                tokens[order[j]] = t
    return 0, reader


@routine
def listed(kinds: Bytes, here: NDArray[np.bool_], all_here: bool, which: IntArray, rows: IntArray) -> int:
    """The distribution of each number that is coded, in order; how many there are, -1 for one without."""
    count, least = 0, np.int64(0)
    for i in range(len(kinds)):
        k = np.int64(kinds[i])
        row = which[k >> 2] * 4 + (k & 3)
        rows[count] = row
        there = all_here or here[i]
        least = min(least, row) if there else least
        count += 1 if there else 0
    return -1 if least < 0 else count


@routine
def spread_out(tokens: IntArray, here: NDArray[np.bool_], values: IntArray) -> None:
    """Numbers to their places; 0 where none is coded."""
    j = 0
    for i in range(len(here)):
        values[i] = tokens[j] if here[i] else 0
        j += int(here[i])


@routine
def chosen(
    good: NDArray[np.bool_], shape: IntArray, new: IntArray, axis: int, step: int, channel: int,
    here: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Which of a stage's nodes, of dimensions ``new``, of a channel are good."""
    last = len(shape) - 1
    row = new[last]
    for at in range(0, len(here), row):
        rest, flat, stride = at // row, 0, shape[last]
        for k in range(last - 1, -1, -1):
            index = (rest % new[k]) * (step if k < axis else 2 * step) + (step if k == axis else 0)
            rest //= new[k]
            flat += index * stride
            stride *= shape[k]
        flat += channel * stride + (step if last == axis else 0)
        for i in range(row):
            here[at + i] = good[flat + i * 2 * step]


@compiled
def decoded(
    start: Numbers,
    shape: IntArray,
    seed: int,
    rules: IntArray,
    words: Words,
    in_order: bool,
    which: IntArray,
    ends: Words,
    first: Bytes,
    packed: Bytes,
    good: NDArray[np.bool_],
    usual: int,
    narrowest: int,
    found: Numbers,
) -> int:
    """The numbers of a tile, channels first, flat, into ``found``; what it is wrong in.

    start : (C,) of its first node, in the type it is worked in. shape : of the nodes. rules : as written.
    in_order : tokens are :mod:`fitter.kernels.interleaved`; else, as of version 2, those of a channel's stage
    kind by kind. which : (256,) the distribution of each class, -1 for none. ends, first : of
    :func:`fitter.kernels.range_coder.cumulated`. packed : the bits after the tokens, and 8 bytes of 0.
    good : of the nodes of all channels, flat; empty where all are. usual, narrowest : of
    ``fitter.compression.rules``.
    """
    channels, axes = len(start), len(shape)
    kind = start.dtype.type
    each, longest = 1, 0
    for k in range(axes):
        each *= shape[k]
        longest = max(longest, shape[k])
    if channels * each == 0:
        return 0
    most = 2 + 3 * axes + axes * axes
    dims, new_dims = np.ones(axes, np.int64), np.ones(axes, np.int64)
    known, error = np.empty(channels * each, start.dtype), np.zeros(channels * each, start.dtype)
    spare, wrong = np.empty(channels * each, start.dtype), np.empty(channels * each, start.dtype)
    for c in range(channels):
        known[c] = start[c]
    # A stage's nodes are half of all at most.
    half = max(each // 2, 1) + BLOCK
    seen = np.empty((5, half), start.dtype)
    near, far, slope, bend, unrest = seen[0], seen[1], seen[2], seen[3], seen[4]
    scratch = np.empty(SCRATCH, start.dtype)
    new, missed = np.empty(half, start.dtype), np.empty(half, start.dtype)
    corrections = np.empty(channels * half, start.dtype)
    predicted, widths = np.empty(half, start.dtype), np.empty(half, start.dtype)
    dither, every = np.empty(half, start.dtype), np.empty(half, np.uint8)
    order, tokens, values = np.empty(half, np.int64), np.empty(half, np.int64), np.empty(half, np.int64)
    some = np.ones(half, np.bool_)
    kept = np.zeros((axes, channels, 2, most + 8 + channels), np.int64)
    lengths = np.full((axes, channels, 2), -1, np.int64)
    factors, shares = np.zeros(most + channels, start.dtype), np.zeros(6 + channels, start.dtype)
    counts = np.zeros(most, np.int64)
    states = np.empty(interleaved.LANES, np.uint64)
    reader, word, turn = range_coder.opened(words), interleaved.opened(words, states), 0
    place, bit, available = 0, 0, 8 * (len(packed) - 8)
    step = 1
    while 2 * step < longest:
        step *= 2
    number = 0
    while step > 0:
        for axis in range(axes):
            if step >= shape[axis]:
                continue
            count = (shape[axis] - step + 2 * step - 1) // (2 * step)
            outer, n, inner = inside(dims, axis)
            before, nodes = outer * n * inner, outer * count * inner
            new_dims[:] = dims
            new_dims[axis] = count
            across = 0
            for k in range(axes):
                across += int(k != axis and new_dims[k] > 1)
            sums = 2 + 3 * across
            counts[:2], counts[2:sums] = 2, 4
            for k in range(sums, sums + across * (across - 1) // 2):
                counts[k] = 8
            sums += across * (across - 1) // 2
            width, added, kinds, here = widths[:nodes], dither[:nodes], every[:nodes], some[:nodes]
            for c in range(channels):
                if len(good) > 0:
                    chosen(good, shape, new_dims, axis, step, c, here)
                # The rule of the prediction.
                mine = sums - 1 + c
                if place >= len(rules):
                    return RULES_END
                rule = rules[place]
                place += 1
                weights = kept[axis, c, 0]
                if rule == 5:
                    if place + mine > len(rules):
                        return RULES_END
                    for k in range(mine):
                        weights[k] = rules[place + k] - 128
                    place += mine
                elif rule == 4:
                    if lengths[axis, c, 0] != mine:
                        return NO_RULE
                else:
                    for k in range(mine):
                        weights[k] = 0
                    weights[0] = -8 * (rule & 1)
                    if c > 0:
                        weights[mine - 1] = 64 * (rule >> 1)
                lengths[axis, c, 0] = mine
                # That of the width.
                signs = 6 + c
                if place >= len(rules):
                    return RULES_END
                own = rules[place]
                place += 1
                codes = kept[axis, c, 1]
                if own:
                    if place + signs > len(rules):
                        return RULES_END
                    for k in range(signs):
                        codes[k] = rules[place + k]
                    place += signs
                elif lengths[axis, c, 1] != signs:
                    for k in range(signs):
                        codes[k] = usual
                lengths[axis, c, 1] = signs
                share = 0
                for k in range(sums - 1):
                    share += weights[k]
                factors[0] = kind((1.0 - 0.015625 * share) / counts[0])
                for k in range(sums - 1):
                    factors[1 + k] = kind(0.015625 * weights[k] / counts[k + 1])
                for k in range(c):
                    factors[sums + k] = kind(0.015625 * weights[sums - 1 + k])
                shares[0] = kind(width_of(codes[0]))
                for k in range(1, signs):
                    shares[k] = kind(width_of(codes[k]) if codes[k] else 0.0)
                mine_known, mine_error = known[c * before :], error[c * before :]
                paired(mine_known, mine_error, outer, n, inner, count, near, far, slope, bend, unrest)
                mixed(
                    near, far, slope, bend, unrest, corrections, c, new_dims, axis, factors, shares, scratch,
                    predicted, widths,
                )  # fmt: skip
                dithered(seed, number, c, added)
                classed(width, added, narrowest, kinds)
                if in_order:
                    coded = listed(kinds, here, len(good) == 0, which, order)
                    if coded < 0:
                        return NO_DISTRIBUTION
                    word = interleaved.read(order, coded, turn, states, word, words, ends, first, tokens)
                    turn += coded
                    bit = numbered(tokens, coded, packed, bit, available)
                    if coded < nodes:
                        spread_out(tokens, here, values)
                else:
                    fault, reader = ordered(kinds, here, order, tokens, reader, words, which, ends, first)
                    if fault:
                        return fault
                    if len(good) > 0:
                        for i in range(nodes):
                            tokens[i] = tokens[i] if here[i] else 0
                    coded = nodes
                    bit = numbered(tokens, nodes, packed, bit, available)
                if bit < 0:
                    return BITS_END
                corrected(
                    values if coded < nodes else tokens, here, added, predicted, width,
                    corrections[c * nodes :], new, missed,
                )  # fmt: skip
                after = before + nodes
                woven(mine_known, new, outer, n, inner, count, spare[c * after :])
                woven(mine_error, missed, outer, n, inner, count, wrong[c * after :])
            known, spare = spare, known
            error, wrong = wrong, error
            dims[axis] = n + count
            number += 1
        step //= 2
    if in_order and not interleaved.ended(words, states, word):
        return WORDS_END
    for i in range(len(known)):
        found[i] = known[i]
    return 0
