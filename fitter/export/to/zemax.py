"""Zemax tabular scatter: one channel, on a polar grid about the specular direction."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fitter import directions
from fitter.export import sampling
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject
from fitter.formats import specular, zemax
from fitter.table import Table

#: Degrees from the specular direction: closest where lobes are.
_RADIAL = np.concatenate([np.geomspace(0.1, 20.0, 32), np.arange(22.5, 181.0, 2.5)])
_INCIDENCE, _AZIMUTH = np.arange(0.0, 86.0, 5.0), np.arange(0.0, 181.0, 7.5)


def write(subject: Subject, path: Path) -> Written:
    sampling.isotropic(subject, "a Zemax table")
    return sampling.written_by(zemax.FORMAT, subject.table or _sampled(subject), subject, path)


def _sampled(subject: Subject) -> Table:
    axes = [np.deg2rad(a) for a in (_INCIDENCE, _AZIMUTH, _RADIAL)]
    i, a, r = (c.reshape(-1) for c in np.meshgrid(*axes, indexing="ij"))
    # The specular direction itself, once for each incidence.
    i, a, r = (np.concatenate([c, more]) for c, more in ((i, axes[0]), (a, 0 * axes[0]), (r, 0 * axes[0])))
    wi, wo = directions.vector_from_spherical(i, 0.0 * i), specular.outgoing(i, 0.0, r, a)
    above = wo[:, 2] > 1e-6
    return sampling.on_pairs(subject, wi[above], wo[above])


TARGET = Target(
    "zemax", "Zemax tabular scatter, one channel or X, Y, Z", True, True, ".bsdf",
    "f_r in 1/sr, without the cosine", write, "text/plain; charset=utf-8",
    channels=(1,), tristimulus=True,
)  # fmt: skip
