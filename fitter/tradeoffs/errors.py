"""The three errors of a fit: against the table, of the parameters, of the reflectance.

held_out : relative rms difference from the samples that no fit saw, (f - y)/(|y| + 1 % of the median |y|). It
    is the model's misfit and the measurement's noise as well as the search's error.
parameters : largest distance of a parameter from the reference fit of the same model and metric, in standard
    uncertainties of the reference. Parameters without a stated uncertainty do not count.
reflectance : largest relative difference of the directional-hemispherical reflectance from the reference's,
    at five incidences over the range that was fitted.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fitter.fitting.energy import INCIDENCES, albedos
from fitter.fitting.result import FitResult
from fitter.models import ReflectanceModel
from fitter.tradeoffs.split import Split

FloatArray = NDArray[np.float64]
Dtype: TypeAlias = type[np.floating[Any]]
KINDS = ("held_out", "parameters", "reflectance")
#: Of the median |y|, added below the relative difference, as in a fit's relative rmse.
FLOOR = 0.01


def held_out(
    model: ReflectanceModel, data: Split, columns: list[int], dtype: Dtype = np.float64
) -> float | None:
    """``columns`` : position in the table of each of the model's channels."""
    y = data.value[:, columns]
    if not len(y):
        return None
    f = np.asarray(model.evaluate(data.wi.astype(dtype), data.wo.astype(dtype)), np.float64)
    floor = FLOOR * np.median(np.abs(y), axis=0)
    scale = np.abs(y) + np.where(floor > 0, floor, 1.0)
    return float(np.sqrt(np.mean(np.square((f - y) / scale))))


def parameters(fit: FitResult, reference: FitResult) -> float | None:
    """None where no parameter of the reference has an uncertainty."""
    worst: list[float] = []
    for name, there in reference.parameters.items():
        off = fit.parameters[name].value - there.value
        if name.endswith("psi"):  # an axis: half a turn changes nothing
            off = np.mod(off + 0.5 * math.pi, math.pi) - 0.5 * math.pi
        u = there.standard_uncertainty
        known = np.isfinite(u) & (u > 0)
        worst += (np.abs(off)[known] / u[known]).reshape(-1).tolist()
    return max(worst) if worst else None


def reflectances(
    model: ReflectanceModel, theta_i: tuple[float, float], dtype: Dtype = np.float64
) -> FloatArray:
    """(I, C) at five incidences over the range (rad)."""
    low, high = (min(max(theta, 1e-6), math.radians(85.0)) for theta in theta_i)
    incidences = [(float(theta), 0.0) for theta in np.linspace(low, high, INCIDENCES)]
    return albedos(model, incidences, whole=not model.isotropic(model.spec), dtype=dtype)


def reflectance(found: FloatArray, reference: FloatArray) -> float:
    return float(np.max(np.abs(found - reference) / np.maximum(np.abs(reference), 1e-12)))
