"""OpenEXR: one picture for each incidence, as :mod:`fitter.formats.openexr` has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fitter.export import sampling
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject
from fitter.formats import openexr
from fitter.grid import Grid


def write(subject: Subject, path: Path) -> Written:
    table = subject.table
    if table is None:
        theta_i, theta_o = (
            sampling.degrees(np.arange(0, 90, 3.0)),
            sampling.degrees(np.arange(0.0, 90.0, 1.5)),
        )
        grid = sampling.polar_grid(theta_i, theta_o, 120)
        if subject.symmetry == "anisotropic":
            axes = {
                "theta_i": sampling.degrees(np.arange(0, 90, 10.0)), "phi_i": np.arange(12) * np.pi / 6,
                "theta_o": sampling.degrees(np.arange(0, 90, 3.0)), "phi_o": np.arange(60) * np.pi / 30,
            }  # fmt: skip
            grid = Grid("spherical", axes, {"phi_i": 2 * np.pi, "phi_o": 2 * np.pi})
        table = sampling.on_grid(subject, grid)
    return sampling.written_by(openexr.FORMAT, table, subject, path)


TARGET = Target(
    "openexr", "OpenEXR slices, a picture for each incidence", True, True, ".exr",
    "f_r in 1/sr, without the cosine, as float32", write, "image/x-exr",
)  # fmt: skip
