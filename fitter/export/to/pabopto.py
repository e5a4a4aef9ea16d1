"""pab-opto: a folder with one text file for each incidence, for Radiance's pabopto2bsdf and others."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fitter.export import sampling
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject
from fitter.formats import pabopto


def write(subject: Subject, path: Path) -> Written:
    table = subject.table
    if table is None:
        sampling.isotropic(subject, "a folder of pab-opto files written here")
        theta_i, theta_o = (sampling.degrees(np.arange(0, 86, step)) for step in (5.0, 2.5))
        table = sampling.on_grid(subject, sampling.polar_grid(theta_i, theta_o, 72))
    return sampling.written_by(pabopto.FORMAT, table, subject, path)


TARGET = Target(
    "pab-opto", "pab-opto text, a folder with a file for each incidence", True, True, "",
    "f_r in 1/sr, without the cosine", write, channels=(1,), tristimulus=True,
)  # fmt: skip
