"""Finding: one result of a quality check, and how its numbers are written."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

Verdict = Literal["ok", "notice", "warning"]
#: From harmless to serious.
VERDICTS: tuple[Verdict, ...] = ("ok", "notice", "warning")


@dataclass(frozen=True)
class Finding:
    """What one check found.

    name : a stable identifier. sentence : the finding in one sentence.
    verdict : "ok", "notice" (know this before you use the table) or "warning" (the table, or how it was
        read, is probably wrong there).
    numbers : what the sentence rests on; names carry the unit, None where a number does not exist.
    judged : False where the table does not hold what the check needs; the verdict is "ok" then.
    """

    name: str
    verdict: Verdict
    sentence: str
    numbers: Mapping[str, Any] = field(default_factory=dict[str, Any])
    judged: bool = True

    def to_dict(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "verdict": self.verdict,
            "judged": self.judged,
            "sentence": self.sentence,
            "numbers": {name: _plain(number) for name, number in self.numbers.items()},
        }


def not_judged(name: str, sentence: str, **numbers: Any) -> Finding:
    """A check that the table gives no means for."""
    return Finding(name, "ok", sentence, numbers, judged=False)


def graded(value: float, notice: float, warning: float) -> Verdict:
    """The verdict on a number that should be small."""
    return "warning" if value > warning else "notice" if value > notice else "ok"


def percent(share: float) -> str:
    """A relative quantity to two digits."""
    shown = f"{100 * share:.2g}" if abs(share) < 1 else f"{100 * share:.0f}"
    return f"{shown} %"


def degrees(angle: float) -> str:
    """An angle in radians, written in degrees."""
    return f"{np.rad2deg(angle):.3g}°"


def counted(count: int, one: str, many: str) -> str:
    """A count with its noun."""
    return f"{count:,} {one if count == 1 else many}"


def _plain(number: Any) -> Any:
    """JSON-ready: no NumPy types, None for what is not finite."""
    if isinstance(number, np.ndarray | list | tuple):
        return [_plain(part) for part in number]
    if isinstance(number, Mapping):
        return {str(name): _plain(part) for name, part in number.items()}
    if isinstance(number, np.generic):
        number = number.item()
    if isinstance(number, float):
        return number if math.isfinite(number) else None
    return number
