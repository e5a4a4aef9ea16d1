"""Printing a formula: what is common to the languages."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Mapping, Sequence

from fitter.export.source.formula import Formula

WIDTH = 100
#: In every file: what the numbers are.
CONVENTION = (
    "f_r in 1/sr, without the cosine. Directions are unit vectors that point away from the surface:",
    "wi to the light, wo to the viewer, in the frame of the sample with its normal along +z and its own",
    "x axis along +x. 0 where either is not above the horizon.",
)


def expression(text: str, functions: Mapping[str, str]) -> str:
    """An expression with the functions' names in the language, and pi as a number."""
    text = re.sub(r"\bPI\b", repr(math.pi), text)
    return re.sub(r"\b(\w+)\(", lambda found: f"{functions.get(found[1], found[1])}(", text)


def statements(formula: Formula, functions: Mapping[str, str], kind: str, comment: str = "//") -> list[str]:
    """The formula's lines as ``kind name = expression;``."""
    found: list[str] = []
    for line in formula.lines:
        if line.startswith("#"):
            found.append(comment + line[1:])
            continue
        name, _, value = line.partition(" = ")
        found.append(f"{kind} {name} = {expression(value, functions)};")
    return found


def commented(lines: Sequence[str], mark: str) -> list[str]:
    """``lines`` as comments, wrapped."""
    return [f"{mark} {part}".rstrip() for line in lines for part in textwrap.wrap(line, WIDTH) or [""]]


def indented(lines: Sequence[str], depth: int = 1) -> list[str]:
    return ["    " * depth + line for line in lines]


def text(lines: Sequence[str]) -> bytes:
    return ("\n".join(lines) + "\n").encode()
