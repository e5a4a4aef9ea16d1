"""Values that no reflectance has: negative ones, fill values, constant floors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.fills import repeated
from fitter.masking import FILL
from fitter.quality.finding import Finding, Verdict, counted, not_judged, percent
from fitter.quality.measured import Measured

FloatArray = NDArray[np.float64]

#: Share of negative samples that is a warning whatever their depth.
MANY_NEGATIVE = 0.05
#: Depth in standard deviations of the noise from which on negatives are no noise.
DEEP = 3.0
#: Share of one exactly repeated value that is a warning; that it is said, `fitter.formats.fills` decides.
OFTEN_REPEATED = 0.05
_FEWEST = 5
_HORIZON = float(np.deg2rad(85.0))
_CHUNK = 1 << 18


def negatives(measured: Measured, floor: float | None) -> Finding:
    """Share and depth of negative values. floor : noise (1/sr, k = 1) of the lowest values, None unknown."""
    name = "negatives"
    value = measured.table.value[measured.keep]
    below = value < 0
    share = below.mean(axis=0)
    rows = float(below.any(axis=1).mean())
    numbers: dict[str, Any] = {
        "share_of_samples": rows,
        "share_by_channel": {c.name: float(s) for c, s in zip(measured.table.channels, share, strict=True)},
    }
    if not below.any():
        return Finding(name, "ok", "No value is negative.", numbers)
    depth = -value[below]
    median, deepest = float(np.median(depth)), float(depth.max())
    noise = _noise_of_negatives(measured, below, floor)
    relative = None if not noise else median / noise
    numbers |= {
        "samples": int(below.any(axis=1).sum()), "median_depth_per_sr": median, "deepest_per_sr": deepest,
        "noise_per_sr": noise, "median_depth_over_noise": relative,
    }  # fmt: skip
    deep = relative is not None and relative > DEEP
    verdict: Verdict = "warning" if rows > MANY_NEGATIVE or deep else "notice"
    sentence = (
        f"{percent(rows)} of the samples have a negative value, typically {median:.2g}/sr and at most "
        f"{deepest:.2g}/sr below zero"
    )
    if relative is not None:
        sentence += f", {relative:.2g} times the noise of low values"
        sentence += ": noise does not explain that, look for an offset" if deep else ""
    return Finding(name, verdict, sentence + ".", numbers)


def _noise_of_negatives(measured: Measured, below: NDArray[np.bool_], floor: float | None) -> float | None:
    """Standard deviation (1/sr) of those samples: as stated, else from how smooth low values are."""
    if measured.table.sigma is not None:
        stated = measured.table.sigma[measured.keep][below]
        stated = stated[np.isfinite(stated) & (stated > 0)]
        if len(stated):
            return float(np.median(stated))
    return floor if floor is not None and np.isfinite(floor) and floor > 0 else None


def fill_values(measured: Measured) -> Finding:
    """Zeros and exactly repeated extreme values, in the quantity that the file held."""
    name = "fill_values"
    table = measured.table
    n = int(measured.keep.sum())
    if n < 2 * _FEWEST:
        return not_judged(name, "The samples are too few to tell fill values from measured ones.", samples=n)
    cos_o = _cosines(measured)
    at_horizon = cos_o < np.cos(_HORIZON)
    rows: list[dict[str, Any]] = []
    zeros = near_horizon = 0
    for c in measured.channels:
        value = table.value[measured.keep, c]
        zeros = max(zeros, int(np.count_nonzero(value == 0)))
        near_horizon = max(near_horizon, int(np.count_nonzero(value[at_horizon] == 0)))
        # A floor is constant in what the instrument wrote: f_r times the cosine where the file held that.
        written = value * cos_o if table.metadata.quantity == "ccbrdf" else value
        found = repeated(written, cos_o)
        if found is not None:
            steepest = float(np.rad2deg(np.arccos(np.clip(found.cos_o, -1, 1))))
            rows.append(
                {
                    "channel": table.channels[c].name, "kind": found.kind, "value": found.value,
                    "count": found.count, "share": found.count / n, "theta_o_from_deg": steepest,
                }
            )  # fmt: skip
    numbers: dict[str, Any] = {
        "samples": n, "zeros": zeros, "zeros_beyond_85_deg": near_horizon, "repeated": rows,
        "quantity": table.metadata.quantity,
        "below_the_horizon": int(table.metadata.masked.get("below the horizon", 0)),
        "masked_as_fill": int(table.metadata.masked.get(FILL, 0)),
    }  # fmt: skip
    hidden, filled = numbers["below_the_horizon"], numbers["masked_as_fill"]
    below = ""
    if hidden:
        below = f"; {counted(hidden, 'sample is', 'samples are')} not above the horizon and left out"
    if filled:
        below += f"; {counted(filled, 'fill value was', 'fill values were')} left out on reading"
    if not rows:
        return Finding(name, "ok", f"{_no_fill(zeros, n)}{below}.", numbers)
    worst = max(rows, key=lambda row: row["count"])
    share = float(worst["share"])
    what = {
        "zero": "are exactly 0", "floor": f"are exactly the smallest value, {worst['value']:.4g}",
        "ceiling": f"are exactly the largest value, {worst['value']:.4g}",
        "constant": f"are exactly {worst['value']:.4g}",
    }[worst["kind"]]  # fmt: skip
    why = {
        "zero": "fill values or a clipped background, not measured reflectance",
        "floor": "a detection limit or a fill value", "ceiling": "a saturated detector or a clipped file",
        "constant": "the table is that of an ideal diffuser, or was made, not measured",
    }[worst["kind"]]  # fmt: skip
    verdict: Verdict = "warning" if share > OFTEN_REPEATED and worst["kind"] != "constant" else "notice"
    remedy = "; fills='floors' leaves them out" if worst["kind"] in ("zero", "floor") else ""
    sentence = (
        f"{worst['count']:,} of {n:,} values of channel {worst['channel']} {what}: {why}{remedy}{below}."
    )
    return Finding(name, verdict, sentence, numbers)


def _no_fill(zeros: int, n: int) -> str:
    if not zeros:
        return "No fill value or constant floor stands out, and no value is exactly 0"
    return f"No constant floor stands out; {counted(zeros, 'value is', 'values are')} exactly 0, of {n:,}"


def _cosines(measured: Measured) -> FloatArray:
    """(n,) cos(theta_o) of all measured samples, made in pieces."""
    rows = np.flatnonzero(measured.keep)
    found = np.empty(len(rows))
    for start in range(0, len(rows), _CHUNK):
        part = rows[start : start + _CHUNK]
        found[start : start + _CHUNK] = measured.table.directions(part)[1][:, 2]
    return found
