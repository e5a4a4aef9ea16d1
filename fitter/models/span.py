"""Span: of how few functions of the directions a family's terms are made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Span:
    """The terms at any pair are a combination of their own values at a few reference pairs.

    The combination is the pair's own and the same for all parameters:
    term_k(q; pair) = sum_j a_jk(pair) term_k(q; reference_j). For Ward's lobe, say, D(theta_h; alpha) is the
    only factor that knows alpha, so that one reference with the pair's theta_h does.

    within : "theta_h" where this holds among pairs of one theta_h, "all" where it holds among all pairs.
    references : (theta_h, theta_d, phi_d) in rad of the reference pairs, above the horizon whatever the
        theta_h; theta_h is the pair's own within "theta_h".
    parameters : as many sets of nonlinear parameters, name and value, at which the terms determine a_jk:
        those of the widest lobe, so that no term is 0 there and not elsewhere.
    """

    within: Literal["theta_h", "all"]
    references: tuple[tuple[float, float, float], ...]
    parameters: tuple[tuple[tuple[str, float], ...], ...]


def of_half_vector(parameters: tuple[tuple[str, float], ...]) -> Span:
    """The span of lobes that are a function of theta_h and the parameters times one of the directions."""
    # Across the plane of the normal and the half vector: both directions are then above the horizon.
    return Span("theta_h", ((0.0, 0.5, 1.5707963267948966),), (parameters,))
