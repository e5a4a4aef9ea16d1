"""How a stage's nodes are predicted from their neighbours, and how wide the errors are expected to be.

Both are weighted sums, their weights fitted to the tile when it is compressed and stored with it in a byte
each. Predicted values mix the means of
:class:`fitter.compression.stages.Neighbours`; on smooth tables the fit finds
cubic interpolation, on noisy ones an average of all of them. Where a channel's error is known, it helps to
predict the next channel's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fitter.compression.stages import Neighbours, Numbers

FloatArray = NDArray[np.float64]

#: Weights of the prediction are multiples of this.
_UNIT = 1.0 / 64.0
#: Stages with fewer nodes take one of the stated rules: a fitted one would cost more than it saves.
FEWEST = 200
#: Nodes that a rule is fitted to, evenly chosen.
_FITTED_TO = 16_384
#: The cubic through four nodes: -1/16 each of the two outer ones (Catmull-Rom at the middle).
_CUBIC = -8
_PREVIOUS, _OWN = 4, 5
#: Width classes: half octaves of the expected |error| in steps, from 2^NARROWEST.
NARROWEST, CLASSES = -7, 48
#: Weight of each sign, and of the constant, where nothing has been learnt, as it is coded: 1/4.
USUAL = 176


@dataclass(frozen=True)
class Seen:
    """One channel's new nodes: ``sums`` and ``counts`` as in Neighbours, (*nodes) each, ``corrections`` of
    the channels before this one, in steps, and the signs of a large error to come."""

    sums: Sequence[Numbers]
    counts: Sequence[int]
    corrections: Sequence[Numbers]
    signs: Sequence[Numbers]

    @staticmethod
    def of(near: Neighbours, k: int, corrections: Sequence[Numbers]) -> Seen:
        sums = [part[k] for part in near.sums]
        spread = np.abs(sums[1] - sums[0])
        for part in sums[2:-1:3]:
            away = part * spread.dtype.type(0.5)
            away -= sums[0]
            spread += np.abs(away, out=away)
        signs = [
            near.unrest[k], near.around[k], near.slope[k], near.bend[k], spread,
            *(np.abs(c) for c in corrections),
        ]  # fmt: skip
        return Seen(sums, near.counts, list(corrections), signs)

    def predicted(self, weights: Sequence[int]) -> Numbers:
        """The sum of the means, which the weights (of all but the first) mix, and of the corrections."""
        others = len(self.sums) - 1
        number = self.sums[0].dtype.type
        found = self.sums[0] * number((1.0 - _UNIT * sum(weights[:others])) / self.counts[0])
        counts = [*self.counts[1:], *(1 for _ in self.corrections)]
        parts = [*self.sums[1:], *self.corrections]
        for weight, part, count in zip(weights, parts, counts, strict=True):
            if weight:
                found += part * number(_UNIT * weight / count)
        return found

    @property
    def count(self) -> int:
        """How many weights a prediction has."""
        return len(self.sums) - 1 + len(self.corrections)

    def width(self, weights: Sequence[int]) -> Numbers:
        """Expected |error| in steps; weights are coded as in :func:`_coded`, the first is the constant."""
        number = self.sums[0].dtype.type
        found = np.full_like(self.sums[0], _decoded(weights[0]))
        for weight, part in zip(weights[1:], self.signs, strict=True):
            if weight:
                found += part * number(_decoded(weight))
        return found

    def stated(self, number: int) -> list[int]:
        """The rules that need no weights: linear or cubic, without or with the last channel's correction."""
        cubic, with_correction = number & 1, number >> 1
        weights = [0] * self.count
        weights[0] = cubic * _CUBIC
        if self.corrections:
            weights[-1] = 64 * with_correction
        return weights


def classes(width: Numbers) -> NDArray[np.uint8]:
    """The class of each expected width: its exponent and first mantissa bit, read off the number itself."""
    if width.dtype == np.float32:
        half_octaves = (width.view(np.int32) >> 22) - ((127 + NARROWEST) << 1)
    else:
        half_octaves = (width.view(np.int64) >> 51) - ((1023 + NARROWEST) << 1)
    return np.clip(half_octaves, 0, CLASSES - 1, out=half_octaves).astype(np.uint8)


def next_error(correction: Numbers, width: Numbers) -> Numbers:
    """What a node says of the errors to come around it: its own, and what was expected of it."""
    found = np.abs(correction)
    found *= found.dtype.type(0.6)
    found += width * width.dtype.type(0.4)
    return found


@dataclass
class Rules:
    """The rules of a tile, as they are chosen; :mod:`fitter.kernels.tiles` reads them.

    written : what stands in the file. The rules before are kept by axis and channel: a stage may say "the
    same again".
    """

    written: list[int] = field(default_factory=list[int])
    _predictions: dict[tuple[int, int], list[int]] = field(default_factory=dict[tuple[int, int], list[int]])
    _widths: dict[tuple[int, int], list[int]] = field(default_factory=dict[tuple[int, int], list[int]])

    def choose(
        self, key: tuple[int, int], seen: Seen, target: FloatArray, good: NDArray[np.bool_]
    ) -> tuple[list[int], list[int]]:
        """The same, fitted to ``target`` (*nodes) where ``good``, and written down."""
        rows = np.flatnonzero(good)
        rows = rows[:: max(1, len(rows) // _FITTED_TO)]
        t = target.reshape(-1)[rows]
        sums, corrections, signs = (
            [part.reshape(-1)[rows].astype(np.float64) for part in parts]
            for parts in (seen.sums, seen.corrections, seen.signs)
        )
        few = Seen(sums, seen.counts, corrections, signs)
        options: list[tuple[int, list[int]]] = [(n, few.stated(n)) for n in range(4 if corrections else 2)]
        previous = self._predictions.get(key)
        if previous is not None and len(previous) == len(options[0][1]):
            options.append((_PREVIOUS, previous))
        if len(rows) >= FEWEST:
            options.append((_OWN, _fitted_weights(few, t)))
        scale = int(np.count_nonzero(good)) / max(1, len(rows))
        costs = [
            scale * float(np.log2(np.abs(t - few.predicted(weights)) + 0.5).sum())
            + (8 * len(weights) if number == _OWN else 0)
            for number, weights in options
        ]
        number, weights = options[int(np.argmin(costs))]
        self.written.append(number)
        if number == _OWN:
            self.written += [weight + 128 for weight in weights]
        if len(rows) >= FEWEST:
            widths = _fitted_widths(few, np.abs(t - few.predicted(weights)))
            self.written += [1, *widths]
        else:
            widths = self._usual_widths(key, seen)
            self.written.append(0)
        return self._remember(key, weights, widths)

    def _usual_widths(self, key: tuple[int, int], seen: Seen) -> list[int]:
        before = self._widths.get(key)
        if before is not None and len(before) == 1 + len(seen.signs):
            return before
        return [USUAL] * (1 + len(seen.signs))

    def _remember(
        self, key: tuple[int, int], weights: list[int], widths: list[int]
    ) -> tuple[list[int], list[int]]:
        self._predictions[key], self._widths[key] = weights, widths
        return weights, widths


def _fitted_weights(seen: Seen, target: FloatArray) -> list[int]:
    """Weights of the least sum of |errors|, by reweighted least squares: bits go by the errors' logarithm."""
    first, *others = (part / count for part, count in zip(seen.sums, seen.counts, strict=True))
    columns = np.stack([*(mean - first for mean in others), *seen.corrections])
    away = target - first
    error = np.abs(away) + 1.0
    found = np.zeros(len(columns))
    for _ in range(4):
        weighted = columns / error
        normal = weighted @ columns.T
        normal += 1e-4 * np.trace(normal) / len(normal) * np.eye(len(normal)) + 1e-300 * np.eye(len(normal))
        found = np.linalg.solve(normal, weighted @ away)
        error = np.abs(away - found @ columns) + 0.5
    return [int(w) for w in np.clip(np.rint(found / _UNIT), -128, 127)]


def _fitted_widths(seen: Seen, error: FloatArray) -> list[int]:
    """Weights (coded) with which the signs predict |errors|, in proportion."""
    from scipy.optimize import nnls  # a third of a second, and reading needs none of it

    signs = np.stack([np.ones_like(error), *seen.signs], axis=1)
    expected = np.median(error) + 0.2 + 0.5 * signs[:, 1]
    found = np.zeros(signs.shape[1])
    for _ in range(2):
        found, _rest = nnls(signs / expected[:, None], error / expected)
        expected = signs @ found + 0.05
    return [_coded(float(weight)) for weight in found]


def _coded(weight: float) -> int:
    """A byte: three bits of mantissa, five of exponent; 0 is 0."""
    if weight < 2.0**-23:
        return 0
    mantissa, exponent = np.frexp(weight)
    eighths = round(float(mantissa) * 16) - 8
    exponent = int(exponent) + (eighths == 8)
    return int(np.clip(((exponent + 23) << 3) | (eighths % 8), 1, 255))


def _decoded(code: int) -> float:
    return float(np.ldexp((8 + (code & 7)) / 16.0, (code >> 3) - 23))
