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
    what is unknown. The prior is flat in that coordinate between the bounds.
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

    def __post_init__(self) -> None:
        if not self.lower <= self.default <= self.upper:
            raise ValueError(f"{self.name}: default {self.default} outside [{self.lower}, {self.upper}]")

    @property
    def prior(self) -> str:
        """The prior in words, for reports."""
        if math.isinf(self.upper):
            return f"flat above {self.lower:g}"
        kind = "log-uniform" if self.search == "log" else "uniform"
        return f"{kind} on [{self.lower:g}, {self.upper:g}]"

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
