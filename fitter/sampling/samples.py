"""What every sampler returns, whether it draws from a model or from a raw table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Samples:
    """Directions drawn for one incidence, for several, or together with their incidences.

    wo : (n, 3) unit vectors away from the surface.
    pdf : (n,) density of wo given wi per unit solid angle, 1/sr.
    weight : (n, C) f_r cos(theta_o) / pdf, so that its mean estimates the directional-hemispherical
        reflectance; 0 where the draw was lost below the horizon.
    valid : (n,) False where the draw was lost below the horizon (counts in the mean as weight 0).
    is_delta : (n,) True for draws of an ideal mirror component, whose pdf and value are not densities.
    acceptance : accepted share of the candidates; 1 for samplers that reject nothing.
    seed : the integer seed that gives these draws again, or None when a JAX key was passed.
    evaluations : candidates that were tried; None for samplers that try none.
    wi : (n, 3) the incidence of each draw, None where all have the one that was asked for. Where incidences
        were drawn, too, ``pdf`` is the joint density in 1/sr^2, and ``weight`` f_r cos(theta_i) cos(theta_o)
        / pdf.
    """

    wo: NDArray[np.float64]
    pdf: NDArray[np.float64]
    weight: NDArray[np.float64]
    valid: NDArray[np.bool_]
    is_delta: NDArray[np.bool_]
    acceptance: float
    seed: int | None
    evaluations: int | None = None
    wi: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.wo)
