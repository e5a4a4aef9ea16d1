"""The parameter table: one declaration that bounds, priors, docs, help texts and schemas come from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class Parameter:
    """One parameter of a reflectance model.

    ``linear`` parameters enter f_r linearly (possibly after a change of variables, as Schlick's F0) and
    are always per channel; the others are shared by the channels unless ``per_channel``.
    ``search`` is the coordinate in which the range is explored: "log" where the order of magnitude is
    what is unknown. The prior is flat in that coordinate over ``searched``: the bounds, unless
    ``search_range`` is narrower (a logarithm can't start at 0).
    """

    name: str
    unit: str
    lower: float
    upper: float
    default: float
    description: str
    linear: bool = False
    search: Literal["linear", "log"] = "linear"
    per_channel: bool = False
    search_range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not self.lower <= self.default <= self.upper:
            raise ValueError(f"{self.name}: default {self.default} outside [{self.lower}, {self.upper}]")
        low, high = self.searched
        if not self.lower <= low <= high <= self.upper or (self.search == "log" and low <= 0):
            raise ValueError(f"{self.name} can't be searched over [{low}, {high}]")

    @property
    def searched(self) -> tuple[float, float]:
        """The range a fit explores unless it is told another."""
        return self.search_range or (self.lower, self.upper)

    @property
    def prior(self) -> str:
        """The prior in words, for reports."""
        if math.isinf(self.upper):
            return f"flat above {self.lower:g}"
        kind = "log-uniform" if self.search == "log" else "uniform"
        low, high = self.searched
        return f"{kind} on [{low:g}, {high:g}]"

    def to_dict(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "unit": self.unit,
            "lower": self.lower,
            "upper": None if math.isinf(self.upper) else self.upper,
            "default": self.default,
            "prior": self.prior,
            "linear": self.linear,
            "per_channel": self.linear or self.per_channel,
            "description": self.description,
        }
