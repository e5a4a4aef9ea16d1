"""Python: a module without dependencies but the standard library's mathematics."""

from __future__ import annotations

from pathlib import Path

from fitter.export.registry import Target, Written
from fitter.export.source import formula_of
from fitter.export.source.formula import FUNCTIONS
from fitter.export.source.printing import CONVENTION, commented, expression, indented, text
from fitter.export.subject import Subject
from fitter.formats.output import write_aside

_BUILT_IN = ("pick", "min", "max")


def write(subject: Subject, path: Path) -> Written:
    assert subject.model is not None
    formula = formula_of(subject.model)
    needed = [name for name in FUNCTIONS if name in formula.functions() and name not in _BUILT_IN]
    names = [argument.name for argument in formula.arguments]
    lines = commented([*subject.comments(), "", *CONVENTION, "", *subject.parameter_lines()], "#")
    lines += ["", *([f"from math import {', '.join(sorted(needed))}", ""] if needed else [])]
    lines += [f"CHANNELS = {formula.channels!r}"]
    lines += [f"# One row a channel: {', '.join(names)}.", "PARAMETERS = ("]
    lines += [
        f"    ({' '.join(f'{float(a.values[k])!r},' for a in formula.arguments)}),"
        for k in range(len(formula.channels))
    ]
    lines += [")", "", ""]
    if "pick" in formula.functions():
        lines += ["def pick(c, a, b):", "    return a if c else b", "", ""]
    lines += ["def brdf(wi, wo):", '    """f_r of all channels, 1/sr."""']
    lines += ["    return tuple(_channel(wi, wo, *row) for row in PARAMETERS)", "", ""]
    lines += [f"def _channel(wi, wo, {', '.join(names)}):"]
    lines += indented([
        "(ix, iy, iz), (ox, oy, oz) = wi, wo",
        "if not (iz > 0.0 and oz > 0.0):",
        "    return 0.0",
        *(line if line.startswith("#") else expression(line, {}) for line in formula.lines),
        f"return {expression(formula.result, {})}",
    ])  # fmt: skip
    write_aside(path, [text(lines)])
    return Written()


TARGET = Target(
    "python", "Python module without dependencies: brdf(wi, wo)", True, False, ".py",
    "f_r in 1/sr, without the cosine", write, "text/x-python; charset=utf-8",
)  # fmt: skip
