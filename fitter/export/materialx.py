"""MaterialX documents: one surface node with its inputs, and the material that holds it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from fitter.export.refit import Refit
from fitter.export.subject import Subject
from fitter.formats.output import write_aside

#: A name and its value: a number, or a colour of one or three channels.
Given = tuple[str, float | NDArray[np.float64]]


def write_surface(
    path: Path, subject: Subject, refit: Refit, kind: str, given: Iterable[Given], convention: str,
    tangent: Sequence[str] = (),
) -> None:  # fmt: skip
    """Write the surface ``kind``. ``tangent`` : lines of nodes, the last of which is called "turned"."""
    name = re.sub(r"\W+", "_", subject.name, flags=re.ASCII).strip("_")[:60] or "material"
    lines = ['<?xml version="1.0"?>', '<materialx version="1.39" colorspace="lin_rec709">']
    lines += [f"  <!-- {escape(line)} -->" for line in (*subject.comments(), refit.sentence(), convention)]
    lines += [f"  {line}" for line in tangent]
    lines += [f'  <{kind} name="surface_{name}" type="surfaceshader">']
    for key, value in given:
        colour = np.ndim(value) > 0
        words = ", ".join(f"{c:.9g}" for c in np.broadcast_to(value, (3 if colour else 1,)).tolist())
        lines.append(f'    <input name="{key}" type="{"color3" if colour else "float"}" value="{words}" />')
    if tangent:
        lines.append('    <input name="geometry_tangent" type="vector3" nodename="turned" />')
    lines += [f"  </{kind}>", f'  <surfacematerial name="material_{name}" type="material">']
    lines += [f'    <input name="surfaceshader" type="surfaceshader" nodename="surface_{name}" />']
    lines += ["  </surfacematerial>", "</materialx>", ""]
    write_aside(path, ["\n".join(lines).encode()])
