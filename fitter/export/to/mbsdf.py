"""NVIDIA's MBSDF: the reflection part, on its grid of polar angles."""

from __future__ import annotations

from pathlib import Path

from fitter.export import sampling
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject
from fitter.formats import mbsdf


def write(subject: Subject, path: Path) -> Written:
    sampling.isotropic(subject, "an MBSDF file")
    table = subject.table
    if table is None:
        table = sampling.on_grid(subject, mbsdf.mbsdf_grid(90, 90))
    return sampling.written_by(mbsdf.FORMAT, table, subject, path)


TARGET = Target(
    "mbsdf", "NVIDIA MBSDF measured reflection, for MDL", True, True, ".mbsdf",
    "f_r in 1/sr, without the cosine", write, channels=(1, 3),
)  # fmt: skip
