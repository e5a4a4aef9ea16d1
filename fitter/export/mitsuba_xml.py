"""Scene snippets of Mitsuba 3: one BSDF with an id, to be included in a scene."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

from fitter.export.refit import Refit
from fitter.export.subject import Subject
from fitter.formats.output import write_aside

_CONVENTION = (
    "Mitsuba's eval is f_r cos(theta_o), f_r in 1/sr; colours are linear RGB.",
    "Include this file in a scene and refer to the BSDF by its id.",
)


def snippet(
    path: Path, subject: Subject, refit: Refit, kind: str, words: Mapping[str, str],
    colours: Mapping[str, Sequence[float]], numbers: Mapping[str, float],
) -> None:  # fmt: skip
    """Write the BSDF ``kind`` with its strings, colours and numbers, and what it is in comments."""
    name = re.sub(r"\W+", "_", subject.name, flags=re.ASCII).strip("_")[:60] or "material"
    comments = [*subject.comments(), refit.sentence(), *_CONVENTION]
    lines = ['<?xml version="1.0" encoding="utf-8"?>', '<scene version="3.0.0">']
    lines += [f"  <!-- {escape(line)} -->" for line in comments]
    lines += [f'  <bsdf type="{kind}" id="{name}">']
    lines += [f'    <string name="{key}" value="{value}"/>' for key, value in words.items()]
    for key, colour in colours.items():
        lines.append(f'    <rgb name="{key}" value="{", ".join(f"{c:.9g}" for c in colour)}"/>')
    lines += [f'    <float name="{key}" value="{value:.9g}"/>' for key, value in numbers.items()]
    lines += ["  </bsdf>", "</scene>", ""]
    write_aside(path, ["\n".join(lines).encode()])
