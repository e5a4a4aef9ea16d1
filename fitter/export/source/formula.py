"""A model as one formula that several languages can be printed from.

A formula is a list of lines ``name = expression`` for one channel, in what Python, C and GLSL have in
common: + - * /, brackets, comparisons, float literals, and the functions of ``FUNCTIONS``. ``pick(c, a, b)``
is a where c holds, else b; both are evaluated, so that arguments are guarded as in the models themselves. A
line that begins with # is a comment. The names of the arguments are parameters of the channel, and ix, iy,
iz, ox, oy, oz the components of wi and wo, both above the horizon; PI is pi.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError

if TYPE_CHECKING:
    from fitter.models import ReflectanceModel

FloatArray = NDArray[np.float64]

FUNCTIONS = ("pick", "min", "max", "sqrt", "exp", "log", "log1p", "sin", "cos", "atan2", "erfc")
DIRECTIONS = ("ix", "iy", "iz", "ox", "oy", "oz")


@dataclass(frozen=True)
class Argument:
    """A number that the formula takes: its values (C,), and its range for programs that show a slider."""

    name: str
    values: FloatArray
    description: str
    lower: float
    upper: float


@dataclass(frozen=True)
class Formula:
    """f_r of one channel, 1/sr: ``lines``, then the value of ``result``."""

    channels: tuple[str, ...]
    arguments: tuple[Argument, ...]
    lines: tuple[str, ...]
    result: str

    def functions(self) -> list[str]:
        """The functions that the lines call, in the order of ``FUNCTIONS``."""
        text = "\n".join([*(line for line in self.lines if not line.startswith("#")), self.result])
        return [name for name in FUNCTIONS if re.search(rf"\b{name}\(", text)]


def arguments_of(model: ReflectanceModel, names: Sequence[str] | None = None) -> list[Argument]:
    """The model's own parameters, or those named, as arguments."""
    found: list[Argument] = []
    for p in model.table:
        if names is not None and p.name not in names:
            continue
        values = np.broadcast_to(np.asarray(model.values[p.name], np.float64), (len(model.channels),))
        upper = p.upper if np.isfinite(p.upper) else max(1.0, 2.0 * float(values.max()))
        found.append(Argument(p.name, values, f"{p.description} (unit {p.unit})", p.lower, upper))
    return found


def derived(name: str, values: FloatArray, description: str, count: int) -> Argument:
    """A number that is computed from the parameters here, once, rather than in the formula."""
    wide = np.broadcast_to(np.asarray(values, np.float64), (count,))
    span = max(1.0, 2.0 * float(np.abs(wide).max()))
    return Argument(name, wide, description, -span, span)


def formula_of(model: ReflectanceModel) -> Formula:
    """The formula of a model of the four families, or Lambert's. Raises SpecError for any other."""
    from fitter.export.source import lafortune, lambert, oren_nayar, torrance_sparrow, ward

    written = {
        "ward": ward.formula, "torrance_sparrow": torrance_sparrow.formula, "lafortune": lafortune.formula,
        "oren_nayar": oren_nayar.formula, "lambert": lambert.formula,
    }  # fmt: skip
    make = written.get(model.spec.family)
    if make is None:
        raise SpecError(
            f"there is no source of {model.spec.name}", code="export-no-source", parameter="to",
            remedy=f"export it as a table, or use one of {', '.join(written)}",
        )  # fmt: skip
    return _needed(make(model))


def _needed(formula: Formula) -> Formula:
    """The formula without lines that nothing reads, which compilers warn of."""
    wanted = set(re.findall(r"\w+", formula.result))
    kept: list[str] = []
    for line in reversed(formula.lines):
        if line.startswith("#"):
            # A comment is about the line below it.
            if kept and not kept[-1].startswith("#"):
                kept.append(line)
            continue
        name, _, value = line.partition(" = ")
        if name in wanted:
            kept.append(line)
            wanted |= set(re.findall(r"\w+", value))
    return replace(formula, lines=tuple(reversed(kept)))
