"""MERL binary: a model at the centres of the database's cells, a table as its writer does it."""

from __future__ import annotations

from pathlib import Path

from fitter.export import sampling
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject
from fitter.formats import merl


def write(subject: Subject, path: Path) -> Written:
    sampling.isotropic(subject, "a MERL file")
    table = subject.table or sampling.on_grid(subject, merl.merl_grid(merl.DIMS))
    return sampling.written_by(merl.FORMAT, table, subject, path)


TARGET = Target(
    "merl", "MERL binary, RGB on 90 x 90 x 180 cells", True, True, ".binary",
    "f_r in 1/sr, without the cosine, times the database's scales", write, channels=(1, 3),
)  # fmt: skip
