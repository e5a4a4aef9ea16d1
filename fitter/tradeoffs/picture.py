"""The picture of a tradeoff: error against seconds, log-log, every point labelled, the Pareto front drawn."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from matplotlib.transforms import Bbox

from fitter.report.figures import GRID, INK, legend, plain, styled
from fitter.report.palette import BLUE, GREEN, PURPLE, VERMILLION
from fitter.tradeoffs.front import front

if TYPE_CHECKING:
    from fitter.tradeoffs.result import Point, Tradeoff

DPI = 110
#: Below this an error is drawn as this: the points are the same to all the digits that matter.
LEAST = 1e-9
LOOKS = {
    "reference": ("*", INK), "default": ("D", VERMILLION), "subset": ("o", BLUE), "starts": ("^", GREEN),
    "solver": ("s", PURPLE), "metric": ("P", "#e69f00"), "compression": ("v", "#56b4e9"),
}  # fmt: skip
TITLES = {
    "held_out": ("Against held-out incidences", "relative rms error"),
    "parameters": ("Parameters, from the reference fit", "largest error (standard uncertainties)"),
    "reflectance": ("Directional-hemispherical reflectance", "largest relative error"),
}
#: Where a label may go around its point, in points of the page, the usual place first.
PLACES = tuple(
    (reach * x, reach * y, "left" if x > 0 else "right" if x < 0 else "center")
    for reach in (7, 14, 24, 36, 50)
    for x, y in ((1, 0.3), (1, 1), (1, -1), (-1, 0.3), (-1, 1), (-1, -1), (0, 1.2), (0, -1.2))
)


def draw(tradeoff: Tradeoff, kind: str = "png") -> bytes:
    """The picture as bytes, PNG or SVG."""
    figure = Figure(figsize=(17.5, 11.0), facecolor="white", layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = cast("np.ndarray[Any, Any]", figure.subplots(2, 3))
    figure.suptitle(
        plain(_title(tradeoff), 200), fontsize=13, color=INK, x=0.01, ha="left", fontweight="bold"
    )
    waiting: list[tuple[Axes, list[Point], list[float], list[float]]] = []
    for column, error in enumerate(TITLES):
        shown = _shown(tradeoff.points, error)
        waiting.append(_panel(axes[0, column], shown, error, "seconds"))
    waiting.append(_panel(axes[1, 0], _shown(tradeoff.points, "held_out"), "held_out", "memory"))
    _compression(axes[1, 1], tradeoff)
    _posterior(axes[1, 2], tradeoff)
    canvas.draw()  # what has to stay apart is known only once everything has its place
    for panel, shown, x, y in waiting:
        _labels(panel, shown, x, y, len(tradeoff.spec.models) > 1)
    stream = io.BytesIO()
    figure.savefig(stream, format=kind, dpi=DPI, metadata={"Date": None} if kind == "svg" else None)
    return stream.getvalue()


def _title(tradeoff: Tradeoff) -> str:
    table, machine = tradeoff.table, tradeoff.machine
    return (
        f"What accuracy costs: {table['name'] or 'table'}, {table['fitted']:,} samples fitted, "
        f"{table['held_out']:,} held out; {machine['cpu']}, {machine['cores']} cores"
    )


def _shown(points: Sequence[Point], error: str) -> list[Point]:
    """The fits that have this error; a reference has none of its own."""
    return [
        p for p in points
        if p.axis != "precision" and p.errors.get(error) is not None
        and (error == "held_out" or p.axis != "reference")
    ]  # fmt: skip


def _panel(
    axes: Axes, shown: list[Point], error: str, cost: str
) -> tuple[Axes, list[Point], list[float], list[float]]:
    title, label = TITLES[error]
    _styled(axes, title if cost == "seconds" else f"{title}, by memory", label)
    words = {"seconds": "seconds (warm, fastest)", "memory": "memory during the fit (MB)"}
    axes.set_xlabel(words[cost], fontsize=10)
    if cost == "memory":
        shown = [p for p in shown if p.memory_bytes is not None]
        x = [max(p.memory_bytes or 0, 1e4) / 1e6 for p in shown]
    else:
        x = [p.seconds["min"] for p in shown]
    y = [max(p.errors[error] or 0.0, LEAST) for p in shown]
    if not shown:
        _nothing(axes, "not measured")
        return axes, [], [], []
    on = front(x, y)
    axes.step(
        [x[k] for k in on], [y[k] for k in on], where="post", color=INK, linewidth=1.1, alpha=0.5, zorder=1,
        label="Pareto front",
    )  # fmt: skip
    for axis, (marker, colour) in LOOKS.items():
        picked = [k for k, p in enumerate(shown) if p.axis == axis]
        if picked:
            axes.plot(
                [x[k] for k in picked], [y[k] for k in picked], marker, color=colour,
                markersize=14 if marker == "*" else 8, markeredgecolor="white", linestyle="none", label=axis,
                zorder=3,
            )  # fmt: skip
    _logarithmic(axes, x, y)
    if error == "held_out" and cost == "seconds":
        legend(axes, loc="upper left", ncols=2)
    return axes, shown, x, y


def _logarithmic(axes: Axes, x: Sequence[float], y: Sequence[float]) -> None:
    for which, values, room in (("x", x, (0.12, 0.38)), ("y", y, (0.12, 0.22))):
        low, high = math.log10(min(values)), math.log10(max(values))
        width = max(high - low, 0.25)
        limits = (10 ** (low - room[0] * width), 10 ** (high + room[1] * width))
        if which == "x":
            axes.set_xscale("log")
            axes.set_xlim(*limits)
        else:
            axes.set_yscale("log")
            axes.set_ylim(*limits)
        axis = axes.xaxis if which == "x" else axes.yaxis
        ratio = limits[1] / limits[0]
        # Within a decade or so the powers of ten alone would leave an axis without numbers.
        axis.set_major_locator(
            MaxNLocator(5) if ratio < 6 else LogLocator(subs=(1.0, 2.0, 5.0) if ratio < 200 else (1.0,))
        )
        axis.set_major_formatter(FuncFormatter(_tick))
        axis.set_minor_formatter(NullFormatter())


def _tick(value: float, position: int | None = None) -> str:
    del position
    return f"{value:.3g}" if 1e-3 <= value < 1e5 else f"1e{round(math.log10(value))}" if value > 0 else ""


def _labels(
    axes: Axes, shown: Sequence[Point], x: Sequence[float], y: Sequence[float], several: bool
) -> None:
    """A label beside each point, moved until it covers neither a point nor another label."""
    renderer = cast("FigureCanvasAgg", cast("Figure", axes.figure).canvas).get_renderer()
    at = axes.transData.transform(np.column_stack([x, y])) if shown else np.empty((0, 2))
    taken = [Bbox.from_bounds(px - 6, py - 6, 12, 12) for px, py in at]
    old = axes.get_legend()
    if old is not None:
        taken.append(old.get_window_extent(renderer))
    frame = axes.get_window_extent(renderer)
    for k in np.argsort(-np.asarray(y)):
        words = shown[k].label if several else shown[k].label.partition(": ")[2] or shown[k].label
        text = axes.annotate(
            plain(words, 40), (x[k], y[k]), xytext=(0, 0), textcoords="offset points", fontsize=8.5,
            color=LOOKS[shown[k].axis][1], va="center", zorder=4,
        )  # fmt: skip
        others = [box for j, box in enumerate(taken) if j != k]
        for dx, dy, side in PLACES:
            text.set_position((dx, dy))
            text.set_horizontalalignment(cast("Any", side))
            box = text.get_window_extent(renderer)
            inside = frame.x0 < box.x0 and box.x1 < frame.x1 and frame.y0 < box.y0 and box.y1 < frame.y1
            if inside and not any(box.overlaps(other) for other in others):
                if math.hypot(dx, dy) > 15:
                    axes.annotate(
                        "", (x[k], y[k]), xytext=(dx, dy), textcoords="offset points", zorder=2,
                        arrowprops={"arrowstyle": "-", "color": GRID, "linewidth": 0.8},
                    )  # fmt: skip
                break
        taken.append(text.get_window_extent(renderer))


def _compression(axes: Axes, tradeoff: Tradeoff) -> None:
    _styled(axes, "Compression", "error")
    axes.set_xlabel("kB of the compressed table", fontsize=10)
    rows = [row for row in tradeoff.compression if row["tolerance"] > 0]
    if not rows:
        _nothing(axes, "not measured")
        return
    x = [row["bytes"] / 1e3 for row in rows]
    drawn: list[float] = []
    for key, label, marker, colour in (
        ("worst_error", "worst relative error of a value", "v", "#56b4e9"),
        ("parameters", "shift of a parameter (standard uncertainties)", "o", VERMILLION),
        ("reflectance", "relative error of the reflectance", "s", GREEN),
    ):
        y = [max(row[key] or 0.0, LEAST) if row[key] is not None else np.nan for row in rows]
        axes.plot(x, y, marker=marker, color=colour, linewidth=1.2, markersize=6, label=label)
        drawn += [value for value in y if np.isfinite(value)]
    _logarithmic(axes, x, drawn)
    for place, row in zip(x, rows, strict=True):
        axes.annotate(
            f"tolerance {row['tolerance']:g}", (place, max(row["worst_error"], LEAST)), xytext=(5, 6),
            textcoords="offset points", fontsize=8.5, color=INK,
        )  # fmt: skip
    legend(axes, loc="upper right")


def _posterior(axes: Axes, tradeoff: Tradeoff) -> None:
    _styled(axes, "Posterior", "error of an interval's end (half widths)")
    axes.set_xlabel("effective samples of the worst parameter", fontsize=10)
    rows = [] if tradeoff.posterior is None else tradeoff.posterior["rows"]
    rows = sorted((row for row in rows if row["interval_error"]), key=lambda row: row["ess"])
    if not rows:
        _nothing(axes, "not measured")
        return
    x, y = [row["ess"] for row in rows], [max(row["interval_error"], LEAST) for row in rows]
    axes.plot(x, y, "o-", color=PURPLE, linewidth=1.2, markersize=7)
    _logarithmic(axes, x, y)
    for place, height, row in zip(x, y, rows, strict=True):
        axes.annotate(
            f"{row['draws']:,} draws, {row['seconds']:.2g} s", (place, height), xytext=(6, 6),
            textcoords="offset points", fontsize=8.5, color=INK,
        )  # fmt: skip


def _styled(axes: Axes, title: str, y: str) -> None:
    styled(axes)
    axes.set_title(plain(title), fontsize=11, color=INK, loc="left", fontweight="bold")
    axes.set_ylabel(y, fontsize=10, color=INK)


def _nothing(axes: Axes, why: str) -> None:
    axes.text(0.5, 0.5, why, ha="center", va="center", fontsize=10, color=INK, transform=axes.transAxes)
    axes.set_xticks([])
    axes.set_yticks([])
