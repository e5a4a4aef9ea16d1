"""A formula in GLSL (1.30 and later, ES 3.00), float32."""

from __future__ import annotations

from functools import cache

import numpy as np

from fitter.export.source.formula import DIRECTIONS, Formula
from fitter.export.source.printing import expression, indented, statements

NAMES = {
    "pick": "brdf_pick", "log1p": "brdf_log1p", "erfc": "brdf_erfc", "atan2": "atan",
}  # fmt: skip
#: Degree of the polynomial that stands for erfc: its error is below float32's rounding.
_DEGREE = 9


def number(value: float) -> str:
    """A float32 literal."""
    text = f"{float(np.float32(value)):.9g}"
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def prelude(formula: Formula) -> list[str]:
    """The functions that GLSL does not have."""
    used = formula.functions()
    found: list[str] = []
    if "pick" in used:
        found.append("float brdf_pick(bool c, float a, float b) { return c ? a : b; }")
    if "log1p" in used:
        found += [
            "float brdf_log1p(float x) {",
            "    float u = 1.0 + x;",
            "    return u == 1.0 ? x : log(u)*x/(u - 1.0);",
            "}",
        ]
    if "erfc" in used:
        terms = _erfcx_terms()
        sum_ = number(terms[-1])
        for term in terms[-2::-1]:
            sum_ = f"({sum_})*t + {number(term)}"
        found += [
            "// exp(x^2) erfc(x), a polynomial in t = (1/(1 + x/2) - 5/8)*8/3, for x from 0 to 6.",
            "float brdf_erfc(float x) {",
            "    float t = (1.0/(1.0 + 0.5*x) - 0.625)*(8.0/3.0);",
            f"    return exp(-x*x)*({sum_});",
            "}",
        ]
    return found


def function(formula: Formula) -> list[str]:
    """``float brdf_channel(...)``: f_r of one channel for its parameters and both directions."""
    given = ", ".join(f"float {argument.name}" for argument in formula.arguments)
    return [
        f"float brdf_channel({given}, vec3 wi, vec3 wo) {{",
        *indented([
            "if (!(wi.z > 0.0 && wo.z > 0.0)) return 0.0;",
            *(f"float {d} = w{d[0]}.{d[1]};" for d in DIRECTIONS),
            *statements(formula, NAMES, "float"),
            f"return {expression(formula.result, NAMES)};",
        ]),
        "}",
    ]  # fmt: skip


def call(formula: Formula, channel: int) -> str:
    """The function's value of a channel, its parameters written as numbers."""
    numbers = ", ".join(number(float(argument.values[channel])) for argument in formula.arguments)
    return f"brdf_channel({numbers}, wi, wo)"


@cache
def _erfcx_terms() -> list[float]:
    """Coefficients, the constant first, of exp(x^2) erfc(x) over t in [-1, 1]: fitted here at many points."""
    from scipy.special import erfcx

    t = np.cos(np.linspace(0.0, np.pi, 2001))
    x = 2.0 * (1.0 / (0.375 * t + 0.625) - 1.0)
    fitted = np.polynomial.Chebyshev.fit(t, erfcx(x), _DEGREE, domain=[-1, 1], w=1.0 / erfcx(x))
    return fitted.convert(kind=np.polynomial.Polynomial).coef.tolist()
