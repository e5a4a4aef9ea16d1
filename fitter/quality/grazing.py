"""Grazing angles: do values beyond 80 degrees go on from those below, and how noisy are they.

Beyond about 80 degrees the footprint outgrows the sample, the cosine that is divided out vanishes, and stray
light takes over; a rise towards the mirror direction there is physics, a collapse is not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.quality.finding import Finding, Verdict, degrees, not_judged, percent
from fitter.quality.measured import Measured
from fitter.quality.noise import MAD, Smoothness, robust

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Grazing begins here (radians), and is compared with the band from ``BESIDE`` up to it.
GRAZING, BESIDE = float(np.deg2rad(80.0)), float(np.deg2rad(62.0))
#: Change of level into grazing that is said, and one that is a warning; growth of the lobe is physics.
DROP, COLLAPSE, GROWTH = 0.5, 0.15, 30.0
#: Rise of the noise, and the noise itself, from which on a rise is said.
NOISE_RISE, NOISY = 4.0, 0.05
_FEWEST = 8


def grazing(measured: Measured, found: Smoothness | None) -> Finding:
    """Samples whose incidence or scatter is beyond 80 degrees, against those between 62 and 80."""
    name = "grazing"
    theta_i, _ = directions.spherical_from_vector(measured.wi)
    theta_o, _ = directions.spherical_from_vector(measured.wo)
    beyond = np.maximum(theta_i, theta_o) > GRAZING
    numbers: dict[str, Any] = {"samples_beyond_80_deg": int(beyond.sum()), "share": float(beyond.mean())}
    if beyond.sum() < _FEWEST:
        return not_judged(
            name, f"Hardly any sample lies beyond {degrees(GRAZING)}: grazing reflectance can't be judged.",
            **numbers,
        )  # fmt: skip
    level = measured.level
    change_o = _change(level, theta_i, theta_o)
    change_i = _change(level, theta_o, theta_i)
    noise, beside = _noise(measured, found, theta_i, theta_o)
    numbers |= {
        "change_with_theta_o": change_o, "change_with_theta_i": change_i,
        "relative_noise_beyond_80_deg": noise, "relative_noise_62_to_80_deg": beside,
    }  # fmt: skip
    verdict: Verdict = "ok"
    said: list[str] = []
    for change, what in ((change_o, "scatter"), (change_i, "incidence")):
        if change is None:
            continue
        if change < DROP:
            verdict = "warning" if change < COLLAPSE or verdict == "warning" else "notice"
            rest = percent(max(change, 0.0))
            said.append(f"towards grazing {what} the values drop to {rest} of those before")
        elif change > GROWTH:
            verdict = "notice" if verdict == "ok" else verdict
            said.append(f"towards grazing {what} the values grow {change:.3g} times")
    if noise is not None and beside is not None and noise > NOISY and noise > NOISE_RISE * beside:
        verdict = "notice" if verdict == "ok" else verdict
        what = "stated sigma" if measured.table.sigma is not None else "scatter among neighbouring samples"
        said.append(f"the {what} rises from {percent(beside)} to {percent(noise)}")
    if not said:
        sentence = f"The {int(beyond.sum()):,} samples beyond {degrees(GRAZING)} go on from those below."
        return Finding(name, verdict, sentence, numbers)
    return Finding(name, verdict, f"Beyond {degrees(GRAZING)}: {', and '.join(said)}.", numbers)


def _change(level: FloatArray, fixed: FloatArray, varying: FloatArray) -> float | None:
    """Median level beyond 80 degrees over that of the band below; the other direction stays below the band.

    Compared within bins of the fixed angle, so that the bands hold the same incidences; median of the bins.
    """
    bins = np.floor(np.rad2deg(fixed) / 10.0).astype(int)
    ratios: list[float] = []
    for k in range(int(np.rad2deg(BESIDE) / 10.0)):
        here = bins == k
        high, low = level[here & (varying > GRAZING)], level[here & (varying > BESIDE) & (varying <= GRAZING)]
        if len(high) >= 3 and len(low) >= 3:
            before = float(np.median(low))
            if before > 0:
                ratios.append(float(np.median(high)) / before)
    return float(np.median(ratios)) if ratios else None


def _noise(
    measured: Measured, found: Smoothness | None, theta_i: FloatArray, theta_o: FloatArray
) -> tuple[float | None, float | None]:
    """Relative noise beyond 80 degrees and in the band below: as stated, else residuals from neighbours."""
    worst = np.maximum(theta_i, theta_o)
    sigma = measured.table.sigma
    if sigma is not None:
        size = np.abs(measured.value)
        with np.errstate(over="ignore"):
            # Scaled as robust() undoes it: a stated sigma is a standard deviation already.
            ratio = MAD * sigma[measured.rows] / np.where(size > 0, size, np.nan)
    elif found is not None:
        worst, ratio = worst[found.position], found.ratio
    else:
        return None, None
    bands: tuple[BoolArray, BoolArray] = (worst > GRAZING, (worst > BESIDE) & (worst <= GRAZING))
    noise = [robust(ratio[band]) if band.sum() >= _FEWEST else float("nan") for band in bands]
    beyond, beside = (float(x) if np.isfinite(x) else None for x in noise)
    return beyond, beside
