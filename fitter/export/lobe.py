"""The lobe of a model, as table formats need to know it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.export.subject import Subject
from fitter.formats.rgl_writer import NARROWEST, Lobe, lobe_width
from fitter.models import ReflectanceModel

FloatArray = NDArray[np.float64]

_INCIDENCES, _DRAWS, _SEED = (10.0, 45.0, 70.0), 2000, 7


def lobe_of(subject: Subject) -> Lobe:
    """The lobe about the half vector: of a model with two widths its own, else one that draws show."""
    assert subject.model is not None
    values = subject.model.values
    if "alpha_x" in values:
        # A mirror's samples would lie within the rounding of float32.
        along, across, psi = (float(np.mean(np.asarray(values[k]))) for k in ("alpha_x", "alpha_y", "psi"))
        return Lobe(max(along, NARROWEST), max(across, NARROWEST), psi)
    alpha = _width(subject, subject.model)
    return Lobe(alpha, alpha)


def _width(subject: Subject, model: ReflectanceModel) -> float:
    """GGX's alpha of the lobe, from draws of the model's own sampler."""
    wi: list[FloatArray] = []
    wo: list[FloatArray] = []
    for k, theta in enumerate(_INCIDENCES):
        incidence = directions.vector_from_spherical(np.deg2rad(theta), np.zeros(()))
        drawn = model.sample(incidence, _DRAWS, seed=_SEED + k)
        wo.append(drawn.wo[drawn.valid])
        wi.append(np.broadcast_to(incidence, wo[-1].shape))
    pair = np.concatenate(wi), np.concatenate(wo)
    return lobe_width(*pair, subject.evaluate(*pair)[0].mean(axis=1))
