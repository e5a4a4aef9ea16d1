"""The picture of a calibration: how far the ranks' distribution functions stray, and how far they may."""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fitter.calibration import bands
from fitter.report.figures import GRID, INK, plain, styled
from fitter.report.palette import BLUE, VERMILLION

if TYPE_CHECKING:
    from fitter.calibration.result import Calibration

DPI = 110
#: Parameters that are drawn at most, those with the smallest p first.
MOST = 12


def draw(found: Calibration, kind: str = "png") -> bytes:
    """The picture as bytes."""
    rows = sorted(found.rows(), key=lambda row: row.p)[:MOST]
    n, draws = found.simulations, found.spec.draws
    order = {label: k for k, label in enumerate(found.labels)}
    rows.sort(key=lambda row: order[row.label])
    columns = min(4, len(rows))
    lines = math.ceil(len(rows) / columns)
    figure = Figure(figsize=(3.3 * columns + 0.4, 2.6 * lines + 0.9), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    panels = cast("np.ndarray[Any, Any]", figure.subplots(lines, columns, squeeze=False, sharey=True)).ravel()
    low, high = bands.ecdf_band(n, draws, found.each)
    at = (np.arange(draws) + 1.0) / (draws + 1.0)
    for axes, row in zip(panels, rows, strict=False):
        styled(axes)
        count = bands.ecdf(found.of(row.label), draws)
        axes.fill_between(at, low / n - at, high / n - at, step="mid", color=GRID, linewidth=0)
        axes.axhline(0, color=INK, linewidth=0.7)
        axes.step(at, count / n - at, where="mid", color=BLUE if row.uniform else VERMILLION, linewidth=1.6)
        text = "" if row.covered is None else f", {100 * row.covered / n:.0f} % covered"
        axes.set_title(plain(row.label) + f"\np = {row.p:.2g}{text}", fontsize=9.5, color=INK, loc="left")
        axes.set_xlim(0, 1)
    for axes in panels[len(rows) :]:
        axes.set_visible(False)
    figure.supxlabel("rank of the truth among draws, as a share", fontsize=10, color=INK)
    figure.supylabel("empirical less uniform", fontsize=10, color=INK)
    figure.suptitle(
        plain(f"{found.fit_spec.model.name}: {found.status.replace('_', ' ')}, {n} simulations"),
        fontsize=11, color=INK, x=0.01, ha="left", fontweight="bold",
    )  # fmt: skip
    stream = io.BytesIO()
    figure.savefig(stream, format=kind, dpi=DPI, metadata={"Date": None} if kind == "svg" else None)
    return stream.getvalue()
