"""Terms of a value over boxes, and what is asked of a family."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fitter.scene.boxes import Angles
from fitter.scene.intervals import Interval
from fitter.spec import ModelSpec

Off = frozenset[str]


@dataclass(frozen=True)
class Term:
    """An additive part of a value, the same times n.l, and what they are multiplied by."""

    value: Interval
    lit: Interval
    ratio: Interval


@dataclass(frozen=True)
class Asked:
    """One channel of a model over boxes, without what is ``off``."""

    spec: ModelSpec
    values: Mapping[str, float]
    off: Off
    constants: Mapping[str, Any]
    angles: Angles
    channel: int

    def constant(self, factor: str) -> Interval:
        """What replaces a factor."""
        return Interval.of(np.asarray(self.constants[factor])[self.channel])

    def term(
        self, effect: str, value: Interval, lit: Interval | None = None, ratio: float | Interval = 1.0
    ) -> Term:
        """A term that is absent without ``effect``; else ``ratio`` is what it is multiplied by."""
        shape = self.angles.lz.lo.shape
        left = 0.0 if effect in self.off else ratio
        left = left if isinstance(left, Interval) else Interval.of(np.full(shape, left))
        lit = value * self.angles.lz if lit is None else lit
        return Term(value.clip(0, np.inf), lit.clip(0, np.inf), left)
