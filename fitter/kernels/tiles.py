"""Decoding a tile of a compressed table: what :mod:`fitter.compression.tile` says, in one pass for each
stage.

The numbers have to be the encoder's to the last bit: operations and their order are those of the array
operations of :mod:`fitter.compression.stages` and :mod:`fitter.compression.rules`, in the tile's own type.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.kernels import compiled, part, routine
from fitter.kernels.range_coder import Reader, Words, opened, token
from fitter.kernels.stages import IntArray, Numbers, added_to, dithered, far_apart, inside, neighbours, woven

Bytes = NDArray[np.uint8]

#: What a tile may be wrong in; 0 is nothing.
RULES_END, NO_RULE, NO_DISTRIBUTION, NO_TOKEN, BITS_END = 1, 2, 3, 4, 5


@part
def width_of(code: int) -> float:
    """The weight that a byte is, see ``fitter.compression.rules``."""
    return 0.0 if code < 0 else (8 + (code & 7)) / 16.0 * 2.0 ** ((code >> 3) - 23)


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
    corrections: Numbers, new: Numbers, missed: Numbers, start: int,
) -> None:  # fmt: skip
    """What numbers of steps make of predictions: corrections, known nodes, and what those say of the errors
    to come."""
    kind, u = width.dtype.type, np.uint64(start)
    for i in range(np.uint64(len(here))):
        value = kind(values[i])
        correction = (-value if added[i] < 0 else value) - added[i]
        correction = correction if here[i] else kind(0)
        corrections[0, u + i] = correction
        new[u + i] = predicted[i] + correction
        missed[u + i] = abs(correction) * kind(0.6) + width[i] * kind(0.4)


@routine
def ordered(
    kinds: Bytes, here: NDArray[np.bool_], order: IntArray, tokens: IntArray, reader: Reader, words: Words,
    which: IntArray, ends: Words, first: Bytes,
) -> tuple[int, Reader]:  # fmt: skip
    """Tokens of one group, kind by kind, to their places; what is wrong."""
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
                t, reader = token(reader, words, ends, first, row)
                if t < 0:
                    return NO_TOKEN, reader
                tokens[order[j]] = t
    return 0, reader


@routine
def chosen(
    good: NDArray[np.bool_], shape: IntArray, dims: IntArray, axis: int, step: int, count: int, channel: int,
    here: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Which of a stage's nodes of a channel are good."""
    axes = len(shape)
    index = np.zeros(axes, np.int64)
    for i in range(len(here)):
        flat = channel
        for k in range(axes):
            apart = step if k < axis else 2 * step
            flat = flat * shape[k] + (step + index[k] * 2 * step if k == axis else index[k] * apart)
        here[i] = good[flat]
        for k in range(axes - 1, -1, -1):
            index[k] += 1
            if index[k] < (count if k == axis else dims[k]):
                break
            index[k] = 0


@compiled
def decoded(
    start: Numbers,
    shape: IntArray,
    seed: int,
    rules: IntArray,
    words: Words,
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
    which : (256,) the distribution of each class, -1 for none. ends, first : of
    :func:`fitter.kernels.range_coder.cumulated`. packed : the bits after the tokens, and 8 bytes of 0.
    good : of the nodes of all channels, flat; empty where all are. usual, narrowest : of
    ``fitter.compression.rules``.
    """
    channels, axes = len(start), len(shape)
    kind = start.dtype.type
    total = channels
    for k in range(axes):
        total *= shape[k]
    most = 2 + 3 * axes + axes * axes
    dims = np.ones(axes, np.int64)
    known, error = np.empty(total, start.dtype), np.zeros(total, start.dtype)
    spare, wrong = np.empty(total, start.dtype), np.empty(total, start.dtype)
    if total == 0:
        return 0
    for c in range(channels):
        known[c] = start[c]
    # A stage's nodes are half of all at most.
    half = max(total // 2, 1)
    sums, others = np.empty((most, half), start.dtype), np.empty((4, half), start.dtype)
    new, missed = np.empty(half, start.dtype), np.empty(half, start.dtype)
    corrections, spread = np.empty((1, half), start.dtype), np.empty(half, start.dtype)
    predicted, widths = np.empty(half, start.dtype), np.empty(half, start.dtype)
    dither, every = np.empty(half, start.dtype), np.empty(half, np.uint8)
    order, tokens, some = np.empty(half, np.int64), np.empty(half, np.int64), np.ones(half, np.bool_)
    kept = np.zeros((axes, channels, 2, most + 8 + channels), np.int64)
    lengths = np.full((axes, channels, 2), -1, np.int64)
    counts = np.zeros(most, np.int64)
    reader = opened(words)
    place, bit, available = 0, 0, 8 * (len(packed) - 8)
    largest = 0
    for k in range(axes):
        largest = max(largest, shape[k] - 1)
    step = 1
    while 2 * step <= largest:
        step *= 2
    number = 0
    while step > 0:
        for axis in range(axes):
            if step >= shape[axis]:
                continue
            count = (shape[axis] - step + 2 * step - 1) // (2 * step)
            outer, n, inner = inside(dims, axis, channels)
            size = outer * count * inner
            nodes = size // channels
            used = neighbours(known, error, dims, axis, count, channels, sums, others, spread, counts)
            width, added, kinds, here = widths[:nodes], dither[:nodes], every[:nodes], some[:nodes]
            for c in range(channels):
                at = c * nodes
                if len(good) > 0:
                    chosen(good, shape, dims, axis, step, count, c, here)
                far_apart(sums, used, at, nodes, spread)
                # The rule of the prediction.
                mine = used - 1 + c
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
                for k in range(used - 1):
                    share += weights[k]
                factor = kind((1.0 - 0.015625 * share) / counts[0])
                for i in range(nodes):
                    predicted[i] = 0
                added_to(predicted, sums, 0, at, factor, False, nodes)
                for k in range(used - 1):
                    if weights[k] != 0:
                        factor = kind(0.015625 * weights[k] / counts[k + 1])
                        added_to(predicted, sums, k + 1, at, factor, False, nodes)
                for k in range(c):
                    if weights[used - 1 + k] != 0:
                        factor = kind(0.015625 * weights[used - 1 + k])
                        added_to(predicted, corrections, 0, k * nodes, factor, False, nodes)
                factor = kind(width_of(codes[0]))
                for i in range(nodes):
                    width[i] = factor
                for k in range(4):
                    if codes[1 + k] != 0:
                        factor = kind(width_of(codes[1 + k]))
                        added_to(width, others, k, at, factor, False, nodes)
                if codes[5] != 0:
                    factor = kind(width_of(codes[5]))
                    for i in range(nodes):
                        width[i] += spread[i] * factor
                for k in range(c):
                    if codes[6 + k] != 0:
                        factor = kind(width_of(codes[6 + k]))
                        added_to(width, corrections, 0, k * nodes, factor, True, nodes)
                dithered(seed, number, c, added)
                classed(width, added, narrowest, kinds)
                # Tokens stand class by class.
                fault, reader = ordered(kinds, here, order, tokens, reader, words, which, ends, first)
                if fault:
                    return fault
                for i in range(nodes):
                    t = tokens[i] if here[i] else 0
                    value = (t >> 1) ^ -(t & 1)
                    if t >= 32:
                        more = ((t - 32) >> 3) + 2
                        bit += more
                        if bit > available:
                            return BITS_END
                        rest = np.int64(0)
                        for k in range(more):
                            p = bit - more + k
                            rest |= np.int64((packed[p >> 3] >> (p & 7)) & 1) << k
                        value = ((8 + ((t - 32) & 7)) << more) | rest
                        value = (value >> 1) ^ -(value & 1)
                    tokens[i] = value
                corrected(tokens, here, added, predicted, width, corrections, new, missed, at)
            woven(known, new, outer, n, inner, count, spare)
            woven(error, missed, outer, n, inner, count, wrong)
            known, spare = spare, known
            error, wrong = wrong, error
            dims[axis] = n + count
            number += 1
        step //= 2
    for i in range(total):
        found[i] = known[i]
    return 0
