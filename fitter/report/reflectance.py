"""Directional-hemispherical reflectance of the fitted model: does it obey energy conservation."""

from __future__ import annotations

from typing import Any

import numpy as np

from fitter import directions
from fitter.report.fitted import Fitted

#: Incidences (degrees) the reflectance is reported at.
INCIDENCES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 85.0)
#: The quadrature's own error (fitter.models.albedo): not a violation.
QUADRATURE_ERROR = 2e-4


def section(fitted: Fitted) -> dict[str, Any]:
    """The reflectance per incidence and channel, JSON-ready, with what is extrapolated or beyond 1."""
    domain = fitted.table.domain
    theta = np.deg2rad(INCIDENCES_DEG)
    values = np.asarray(fitted.fit.model.albedo(directions.vector_from_spherical(theta, 0.0)))
    slack = np.deg2rad(0.05)
    inside = (theta >= domain.theta_i[0] - slack) & (theta <= domain.theta_i[1] + slack)
    names = fitted.fit.model.channels
    largest = np.nanmax(values, axis=1) if np.isfinite(values).any() else np.full(len(theta), np.nan)
    return {
        "channels": list(names),
        "shown": [names[c] for c in fitted.shown],
        "rows": [
            {
                "theta_i_deg": INCIDENCES_DEG[k],
                "reflectance": values[k],
                "extrapolated": not inside[k],
                "above_one": bool(largest[k] > 1 + QUADRATURE_ERROR),
            }
            for k in range(len(theta))
        ],
        "theta_o_measured_deg": [float(np.rad2deg(a)) for a in domain.theta_o],
        "in_plane": domain.in_plane,
        "reciprocal": type(fitted.fit.model).reciprocal(fitted.fit.spec.model),
    }
