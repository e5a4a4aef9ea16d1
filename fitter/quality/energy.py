"""Energy: the directional-hemispherical reflectance at the measured incidences, between bounds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fitter.quality.finding import Finding, Verdict, not_judged, percent
from fitter.quality.hemispheres import Hemisphere
from fitter.quality.measured import Measured

#: Share of the cosine-weighted hemisphere that has to be measured before a reflectance is stated.
ENOUGH = 0.5
#: Rounding of the integral: an ideal white surface is no error.
_ROUNDING = 1e-3


def reflectance(measured: Measured, found: Sequence[Hemisphere]) -> Finding:
    """Whether more light leaves than arrives (rho > 1), beyond twice the stated scale uncertainty."""
    name = "reflectance"
    judged = [one for one in found if one.kind == "area" and one.coverage >= ENOUGH]
    most = max((one.coverage for one in found), default=0.0)
    if not judged:
        if all(one.kind == "line" for one in found) and found:
            text = "Only the plane of incidence was measured: the directional-hemispherical reflectance "
            text += "can't be judged."
        else:
            text = "At no incidence is half of the cosine-weighted hemisphere measured (at most "
            text += f"{percent(most)}): the directional-hemispherical reflectance can't be judged."
        return not_judged(name, text, largest_coverage=most)
    names = [measured.table.channels[c].name for c in measured.channels]
    rows = [_row(one, names) for one in judged]
    scale = 2.0 * (measured.table.metadata.scale_uncertainty or 0.0)
    peak = max(judged, key=lambda one: float(one.lower.max()))
    channel = int(np.argmax(peak.lower))
    lower, upper = float(peak.lower[channel]), float(peak.upper[channel])
    place = f"at theta_i = {np.rad2deg(peak.theta_i):.3g}° (channel {names[channel]})"
    least = max(float(one.least.max()) for one in judged)
    verdict: Verdict = "ok"
    ends = f"{lower:.3g}", f"{upper:.3g}"
    between = ends[0] if ends[0] == ends[1] else f"between {ends[0]} and {ends[1]}"
    if lower > 1.0 + _ROUNDING:
        verdict = "warning" if least > 1.0 + scale + _ROUNDING else "notice"
        sentence = (
            f"More light leaves than arrives: the directional-hemispherical reflectance is {between} {place}"
        )
        if verdict == "notice":
            sentence += ", though the scale uncertainty or the coarse sampling of a peak may explain it"
    else:
        sentence = f"The directional-hemispherical reflectance is {between} where it is largest, {place}"
        if 0.5 * (lower + upper) > 1.0 + _ROUNDING:
            verdict = "notice"
            sentence += ": what was not measured decides whether it exceeds 1"
    numbers: dict[str, Any] = {
        "incidences": rows,
        "incidences_above_1": sum(float(one.lower.max()) > 1 + _ROUNDING for one in judged),
        "not_judged": len(found) - len(judged), "largest_lower": lower, "scale_uncertainty_k2": scale,
    }  # fmt: skip
    return Finding(name, verdict, sentence + ".", numbers)


def _row(one: Hemisphere, names: Sequence[str]) -> dict[str, Any]:
    return {
        "theta_i_deg": float(np.rad2deg(one.theta_i)), "phi_i_deg": float(np.rad2deg(one.phi_i)),
        "coverage": one.coverage, "lower": dict(zip(names, one.lower.tolist(), strict=True)),
        "upper": dict(zip(names, one.upper.tolist(), strict=True)),
    }  # fmt: skip
