"""A ``.brdf`` file of Disney's BRDF Explorer: the model with a slider for each parameter."""

from __future__ import annotations

from pathlib import Path

from fitter.errors import SpecError
from fitter.export.registry import Target, Written
from fitter.export.source import formula_of, glsl
from fitter.export.source.printing import CONVENTION, commented, indented, text
from fitter.export.subject import Subject
from fitter.formats.output import write_aside


def write(subject: Subject, path: Path) -> Written:
    assert subject.model is not None
    formula = formula_of(subject.model)
    count = len(formula.channels)
    if count not in (1, 3):
        raise SpecError(
            f"BRDF Explorer shows one channel or three, and the model has {count}", code="export-channels",
            parameter="to", remedy="export it as glsl, or fit three of its channels",
        )  # fmt: skip
    sliders: list[str] = []
    calls: list[str] = []
    for k in range(count):
        names: list[str] = []
        for argument in formula.arguments:
            shared = count == 1 or bool((argument.values == argument.values[0]).all())
            name = f"p_{argument.name}" if shared else f"p_{argument.name}_{'rgb'[k]}"
            numbers = (argument.lower, argument.upper, float(argument.values[k]))
            slider = f"float {name} {' '.join(glsl.number(n) for n in numbers)}"
            if slider not in sliders:
                sliders.append(slider)
            names.append(name)
        calls.append(f"brdf_channel({', '.join(names)}, wi, wo)")
    value = ", ".join(calls if count == 3 else calls * 3)
    lines = ["analytic", ""]
    lines += commented([*subject.comments(), *CONVENTION, *subject.parameter_lines()], "#")
    lines += ["", "::begin parameters", *sliders, "::end parameters", "", "::begin shader"]
    lines += [*glsl.prelude(formula), *glsl.function(formula), ""]
    lines += ["vec3 BRDF(vec3 L, vec3 V, vec3 N, vec3 X, vec3 Y) {"]
    lines += indented([
        "vec3 wi = vec3(dot(L, X), dot(L, Y), dot(L, N));",
        "vec3 wo = vec3(dot(V, X), dot(V, Y), dot(V, N));",
        f"return vec3({value});",
    ])  # fmt: skip
    lines += ["}", "::end shader"]
    write_aside(path, [text(lines)])
    return Written()


TARGET = Target(
    "disney", "a .brdf file of Disney's BRDF Explorer, each parameter a slider", True, False, ".brdf",
    "f_r in 1/sr, without the cosine", write, "text/plain; charset=utf-8",
)  # fmt: skip
