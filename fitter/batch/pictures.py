"""The small picture of a fit in the index: one slice, and the residuals against the half angle."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitter.batch import svg
from fitter.documents import write_bytes

if TYPE_CHECKING:
    from fitter.fitting import FitResult
    from fitter.report.fitted import Fitted
    from fitter.table import Table

FloatArray = NDArray[np.float64]

PICTURE = "picture.svg"
#: Dots of a panel and channel at most, and samples that the bands of residuals are made of.
_DOTS, _SAMPLES = 150, 5_000
#: Relative residuals are drawn as asinh(r / _LINEAR) up to _MOST, the same in all pictures, which can so be
#: compared at a glance.
_LINEAR, _MOST = 0.1, 4.0
_RESIDUALS = ((-1.0, "−100 %"), (-0.1, "−10 %"), (0.0, "0"), (0.1, "10 %"), (1.0, "100 %"))


def draw(table: Table, fit: FitResult, place: Path) -> None:
    """Write ``picture.svg``: a slice, where samples lie near the plane of incidence, and the residuals."""
    from fitter.report import slices
    from fitter.report.fitted import Fitted

    fitted = Fitted.of(table, fit)
    cuts = slices.section(fitted, None, None, fit.spec.seed, middle=True)
    panels = [_slice(cut, cuts["channels"], fit.spec.seed) for cut in cuts["slices"]]
    panels.append(_residuals(fitted, fit.spec.seed))
    write_bytes(svg.document(panels).encode(), place / PICTURE)


def _slice(cut: dict[str, Any], channels: list[str], seed: int) -> svg.Panel:
    from fitter.report.fitted import thin
    from fitter.report.palette import colours

    theta, at = _floats(cut["curve"]["theta_o_deg"]), _floats(cut["points"]["theta_o_deg"])
    kept = thin(np.arange(len(at)), _DOTS, seed)
    fits = {name: _floats(cut["curve"]["fit"][name]) for name in channels}
    measured = {name: _floats(cut["points"]["measured"][name]) for name in channels}
    drawn = np.concatenate([*fits.values(), *measured.values()])
    drawn = drawn[np.isfinite(drawn)]
    logarithmic = cut["axis"] == "log"
    high = float(drawn.max(initial=1e-12))
    if logarithmic:
        low = max(float(drawn[drawn > 0].min()), high * 1e-7)
        ends = math.log10(low), math.log10(high)
        ticks = [(k, _power(k)) for k in _powers(*ends)]
    else:
        low = min(0.0, float(drawn.min(initial=0.0)))
        ends = low, high
        ticks = [(end, f"{end:.2g}") for end in ends]
    panel = svg.Panel(
        f"θi {cut['theta_i_deg']:.3g}°: f (1/sr) by θo", (float(theta.min()), float(theta.max())),
        _padded(*ends), _degrees(float(theta.min()), float(theta.max())), ticks,
    )  # fmt: skip
    panel.mark(cut["theta_i_deg"])
    for name, colour in colours(channels).items():
        for curve, x, y in ((False, at[kept], measured[name][kept]), (True, theta, fits[name])):
            shown = np.log10(np.where(y > 0, y, np.nan)) if logarithmic else y
            (panel.line if curve else panel.dots)(x, shown, colour)
    return panel


def _residuals(fitted: Fitted, seed: int) -> svg.Panel:
    from fitter import directions
    from fitter.report import residuals
    from fitter.report.fitted import thin
    from fitter.report.palette import colours

    index = fitted.subsample(_SAMPLES, seed)
    wi, wo = fitted.table.directions(index)
    _, relative = residuals.of_rows(fitted, index, wi, wo)
    half = np.rad2deg(directions.half_difference_from_vectors(wi, wo)[0])
    kept = thin(np.arange(len(index)), _DOTS, seed)
    high = max(float(half.max()), 1.0)
    end = math.asinh(_MOST / _LINEAR)
    panel = svg.Panel(
        "relative residual by θh", (0.0, high), (-end, end), _degrees(0.0, high),
        [(math.asinh(at / _LINEAR), label) for at, label in _RESIDUALS],
    )  # fmt: skip
    names = fitted.fit.model.channels
    shown = [names[c] for c in fitted.shown]
    for colour, c in zip(colours(shown).values(), fitted.shown, strict=True):
        panel.dots(half[kept], np.arcsinh(relative[kept, c] / _LINEAR), colour)
        rows = residuals.binned(half, relative[:, c])
        at, lower, middle, upper = (_floats(rows[key]) for key in ("angle", "lower", "median", "upper"))
        panel.band(at, np.arcsinh(lower / _LINEAR), np.arcsinh(upper / _LINEAR), colour)
        panel.line(at, np.arcsinh(middle / _LINEAR), colour)
    return panel


def _padded(low: float, high: float) -> tuple[float, float]:
    pad = 0.06 * (high - low) or 0.06 * abs(high) or 1e-12
    return low - pad, high + pad


def _degrees(low: float, high: float) -> list[tuple[float, str]]:
    step = next((s for s in (1, 2, 5, 10, 15, 30) if (high - low) / s <= 6), 45)
    first = math.ceil(low / step)
    return [(k * step, f"{k * step}°".replace("-", "−")) for k in range(first, math.floor(high / step) + 1)]


def _powers(low: float, high: float) -> list[int]:
    """At most four whole powers of ten; at least the nearest one."""
    found = list(range(math.ceil(low), math.floor(high) + 1)) or [round(0.5 * (low + high))]
    return found[:: max(1, math.ceil(len(found) / 4))]


def _power(exponent: int) -> str:
    return f"{10.0**exponent:g}" if -3 < exponent < 4 else f"1e{exponent}".replace("-", "−")


def _floats(listed: Any) -> FloatArray:
    """What a record holds as an array; None becomes NaN."""
    return np.asarray(listed, dtype=np.float64)
