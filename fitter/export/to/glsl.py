"""GLSL: a snippet with one function, ``brdf(wi, wo)``, for shaders."""

from __future__ import annotations

from pathlib import Path

from fitter.export.registry import Target, Written
from fitter.export.source import formula_of, glsl
from fitter.export.source.printing import CONVENTION, commented, text
from fitter.export.subject import Subject
from fitter.formats.output import write_aside
from fitter.formats.registry import Loss


def write(subject: Subject, path: Path) -> Written:
    assert subject.model is not None
    formula = formula_of(subject.model)
    channels = formula.channels
    lines = commented([*subject.comments(), "", *CONVENTION, "", *subject.parameter_lines()], "//")
    lines += ["", *glsl.prelude(formula), *glsl.function(formula), ""]
    calls = [glsl.call(formula, k) for k in range(len(channels))]
    notes: tuple[Loss, ...] = ()
    if len(channels) in (1, 3):
        kind = "float" if len(channels) == 1 else "vec3"
        value = calls[0] if len(channels) == 1 else "vec3(\n        " + ",\n        ".join(calls) + ")"
        lines += [f"{kind} brdf(vec3 wi, vec3 wo) {{", f"    return {value};", "}"]
    else:
        lines += ["float brdf(int channel, vec3 wi, vec3 wo) {"]
        lines += [
            f"    if (channel == {k}) return {one};  // {name}"
            for k, (name, one) in enumerate(zip(channels, calls, strict=True))
        ]
        lines += ["    return 0.0;", "}"]
        notes = (Loss("channels", f"{len(channels)} channels: brdf() takes the channel's number, from 0."),)
    write_aside(path, [text(lines)])
    return Written(notes)


TARGET = Target(
    "glsl", "GLSL snippet: a function brdf(wi, wo) for shaders, in float32", True, False, ".glsl",
    "f_r in 1/sr, without the cosine", write, "text/plain; charset=utf-8",
)  # fmt: skip
