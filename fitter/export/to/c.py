"""C (C99): a source file without dependencies but the standard library's mathematics."""

from __future__ import annotations

from pathlib import Path

from fitter.export.registry import Target, Written
from fitter.export.source import formula_of
from fitter.export.source.formula import DIRECTIONS
from fitter.export.source.printing import CONVENTION, commented, expression, indented, statements, text
from fitter.export.subject import Subject
from fitter.formats.output import one_line, write_aside

_NAMES = {"min": "fmin", "max": "fmax"}


def write(subject: Subject, path: Path) -> Written:
    assert subject.model is not None
    formula = formula_of(subject.model)
    count, names = len(formula.channels), [argument.name for argument in formula.arguments]
    about = [*subject.comments(), "", *CONVENTION, "", *subject.parameter_lines()]
    lines = [*commented(about, "//"), "", "#include <math.h>", "", f"#define BRDF_CHANNELS {count}", ""]
    lines += [f"// One row a channel: {', '.join(names)}."]
    lines += [f"static const double brdf_parameters[BRDF_CHANNELS][{len(names)}] = {{"]
    lines += [
        f"    {{{', '.join(repr(float(a.values[k])) for a in formula.arguments)}}},  // {one_line(channel)}"
        for k, channel in enumerate(formula.channels)
    ]
    lines += ["};", ""]
    if "pick" in formula.functions():
        lines += ["static double pick(int c, double a, double b) { return c ? a : b; }", ""]
    lines += ["static double brdf_channel(const double p[], const double wi[3], const double wo[3]) {"]
    lines += indented([
        "if (!(wi[2] > 0.0 && wo[2] > 0.0)) return 0.0;",
        *(f"const double {name} = p[{k}];" for k, name in enumerate(names)),
        *(f"const double {d} = w{d[0]}[{'xyz'.index(d[1])}];" for d in _used(formula.lines)),
        *statements(formula, _NAMES, "const double"),
        f"return {expression(formula.result, _NAMES)};",
    ])  # fmt: skip
    lines += ["}", "", "// f_r of all channels, 1/sr.", f"void brdf({_SIGNATURE}) {{"]
    lines += indented([
        "for (int k = 0; k < BRDF_CHANNELS; k++) value[k] = brdf_channel(brdf_parameters[k], wi, wo);",
    ])  # fmt: skip
    lines += ["}"]
    write_aside(path, [text(lines)])
    return Written()


_SIGNATURE = "const double wi[3], const double wo[3], double value[BRDF_CHANNELS]"


def _used(lines: tuple[str, ...]) -> list[str]:
    """The components that the formula reads: a compiler warns of others."""
    import re

    return [d for d in DIRECTIONS if any(re.search(rf"\b{d}\b", line) for line in lines)]


TARGET = Target(
    "c", "C source without dependencies: void brdf(wi, wo, value)", True, False, ".c",
    "f_r in 1/sr, without the cosine", write, "text/plain; charset=utf-8",
)  # fmt: skip
