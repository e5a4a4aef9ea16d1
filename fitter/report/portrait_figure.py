"""The picture of a measured table: polar slices, the angles covered, the scattered hemisphere.

The object API only (server threads): no global state of matplotlib is touched.
"""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from fitter.report.figures import GRID, INK, MARKERS, plain, power_of_ten
from fitter.report.palette import PURPLE, VERMILLION
from fitter.report.plane import is_wide
from fitter.report.portrait import Cut, Disk, Portrait
from fitter.report.rounding import percent

FloatArray = NDArray[np.float64]

DPI = 110
#: Inches: width of the picture, height of its upper row with the heading, and of its lower row.
WIDTH, UPPER, LOWER = 12.4, 5.0, 4.3
#: Decades below the largest value that a logarithmic radius or colour shows.
MOST_DECADES = 6.0
#: A value so many times the median is a peak that a linear scale would be lost to.
PEAK = 6.0
#: Samples of a slice further apart than this (radians) are not joined.
GAP = math.radians(12.0)
#: Radius of the polar slices at which the smallest value shown lies: the centre would swallow it.
INNER = 0.12
_BACKGROUND, _QUIET = "#e4e7ea", "#8a9299"
_SHADES = colormaps["viridis"]
_TITLE: dict[str, Any] = {"fontsize": 11, "color": INK, "fontweight": "bold"}
_QUANTITY = {"brdf": "f_r", "ccbrdf": "f_r cos θ_o", "reflectance_factor": "π f_r"}


def draw(found: Portrait) -> Figure:
    """The picture; its upper row alone where only the plane of incidence was measured."""
    bottom = LOWER if found.disks else 0.0
    figure = Figure(figsize=(WIDTH, bottom + UPPER), facecolor="white", dpi=DPI)
    FigureCanvasAgg(figure)
    _heading(figure, found)
    _slices(figure, bottom, found)
    _coverage(figure, bottom, found)
    if found.disks:
        _hemispheres(figure, found)
    return figure


def png(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI)
    return stream.getvalue()


def _at(
    figure: Figure, left: float, bottom: float, width: float, height: float, **keywords: Any
) -> Any:  # fmt: skip
    """Axes at a place in inches."""
    w, h = figure.get_size_inches()
    return figure.add_axes((left / w, bottom / h, width / w, height / h), **keywords)


def _words(figure: Figure, x: float, y: float, text: str, **keywords: Any) -> None:
    """Text at a place in inches."""
    w, h = figure.get_size_inches()
    style: dict[str, Any] = {"fontsize": 9.5, "color": INK, "va": "center"} | keywords
    figure.text(x / w, y / h, text, **style)


def _heading(figure: Figure, found: Portrait) -> None:
    table, top = found.table, figure.get_figheight()
    name = plain(table.metadata.name or "measured table", 90)
    _words(figure, 0.25, top - 0.28, name, fontsize=14, fontweight="bold")
    shape = "scattered" if table.grid is None else f"{table.grid.system.replace('_', ' ')} grid"
    facts = [
        table.metadata.source_format, f"values stored as {_QUANTITY[table.metadata.quantity]}",
        f"{len(table):,} samples, {int(table.mask.sum()):,} usable", shape, table.symmetry,
    ]  # fmt: skip
    if found.blind_share is not None:
        facts.append(f"{percent(found.blind_share)} of the measured region blind")
    _words(figure, 0.25, top - 0.58, plain("  ·  ".join(facts), 200), fontsize=10)


def _slices(figure: Figure, bottom: float, found: Portrait) -> None:
    _words(figure, 0.25, bottom + UPPER - 0.98, "Slices through the plane of incidence", **_TITLE)
    # The half disc fills the upper half of a square: what lies below stays empty.
    side = 6.3
    axes: Any = _at(figure, 0.75, bottom + 0.72 - side / 4, side, side, projection="polar")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set_thetamin(-90)
    axes.set_thetamax(90)
    values = np.concatenate([np.empty(0), *(cut.value for cut in found.cuts)])
    values = values[np.isfinite(values)]
    if not (values > 0).any():
        axes.set_axis_off()
        _words(figure, 0.75 + side / 2, bottom + 2.2, "nothing positive was measured there", ha="center")
        return
    log = _logarithmic(values)
    low, high = _range(values, log)
    axes.set_ylim(0, 1.06)
    axes.set_thetagrids(range(-90, 91, 30), [f"{abs(a)}°" for a in range(-90, 91, 30)])
    ticks = _ticks(low, high, log)
    axes.set_rgrids([_radius(t, low, high, log) for t in ticks], [power_of_ten(t) for t in ticks], angle=-90)
    axes.tick_params(labelsize=9, colors=INK)
    axes.grid(True, color=GRID, linewidth=0.7)
    axes.spines["polar"].set_color(GRID)
    shades = [_SHADES(x) for x in np.linspace(0.0, 0.86, len(found.cuts))]
    for k, (cut, shade) in enumerate(zip(found.cuts, shades, strict=True)):
        _slice(axes, cut, shade, MARKERS[k % len(MARKERS)], low, high, log)
    w, h = figure.get_size_inches()
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="upper right", bbox_to_anchor=(8.15 / w, (bottom + UPPER - 0.75) / h),
        fontsize=8.5, frameon=False, title="incidence", title_fontsize=9,
    )  # fmt: skip
    names = [channel.name for channel in found.table.channels]
    of = names[0] if len(names) == 1 else f"mean of {', '.join(names[:3])}{' ...' if len(names) > 3 else ''}"
    azimuth = "" if found.azimuth_deg is None else f"φ_i = {found.azimuth_deg:.0f}°, "
    note = (
        f"radius: f_r in 1/sr ({plain(of)}){', logarithmic' if log else ''}  ·  dashed: specular direction"
        f"  ·  ▼ light  ·  {azimuth}within {found.plane_deg:g}° of the plane"
    )
    _words(figure, 0.25, bottom + 0.3, note, fontsize=9)
    for x, word, align in ((0.95, "light's side", "left"), (6.85, "specular side", "right")):
        _words(figure, x, bottom + 3.55, word, ha=align, color=_QUIET)


def _slice(
    axes: Any, cut: Cut, shade: Any, marker: str, low: float, high: float, log: bool
) -> None:  # fmt: skip
    theta = np.deg2rad(cut.theta_o_deg)
    value = np.where(cut.value >= low if log else cut.value >= 0, cut.value, np.nan)
    radius = np.array([_radius(v, low, high, log) for v in value])
    # A line between samples only where they are neighbours: it must not bridge what was not measured.
    step = np.median(np.diff(theta)) if len(theta) > 2 else np.inf
    gaps = np.flatnonzero(np.diff(theta) > max(4 * step, GAP)) + 1
    few = len(theta) <= 80
    axes.plot(
        np.insert(theta, gaps, np.nan), np.insert(radius, gaps, np.nan), "-", color=shade, linewidth=1.5,
        marker=marker if few else None, markersize=3.4, label=f"θ_i = {_degrees(cut.theta_i_deg)}°",
    )  # fmt: skip
    incidence = np.deg2rad(cut.theta_i_deg)
    axes.plot([incidence, incidence], [0, 1.06], color=shade, linewidth=1.0, linestyle=(0, (4, 3)), zorder=1)
    axes.plot(-incidence, 1.03, marker="v", color=shade, markersize=8, markeredgecolor="white", zorder=4)


def _coverage(figure: Figure, bottom: float, found: Portrait) -> None:
    """Samples by polar angles: usable ones by colour, cells of masked samples only marked."""
    _words(figure, 8.35, bottom + UPPER - 0.98, "Angles covered: usable samples", **_TITLE)
    axes = _at(figure, 8.7, bottom + 0.72, 3.05, 3.05)
    most = max(int(found.counts.max()), 2)
    mesh = axes.pcolormesh(
        *found.edges_deg, np.ma.masked_equal(found.counts.T, 0), cmap="Blues", norm=LogNorm(0.3, most),
        rasterized=True,
    )  # fmt: skip
    lost = np.nonzero((found.counts == 0) & (found.masked > 0))
    notes: list[str] = []
    usable = int(found.table.mask.sum())
    if found.looked_at < usable:
        notes.append(f"counted: {found.looked_at:,} of {usable:,} cells")
    if len(lost[0]):
        at = [(0.5 * (edges[1:] + edges[:-1]))[k] for edges, k in zip(found.edges_deg, lost, strict=True)]
        axes.plot(*at, "x", color=PURPLE, markersize=3.5)
        notes.append("× masked samples only")
    _words(figure, 10.3, bottom + 0.12, "  ·  ".join(notes), ha="center", fontsize=9)
    axes.plot([0, 90], [0, 90], color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    axes.set_facecolor(_BACKGROUND)
    for axis, label in ((axes.xaxis, "θ_i (deg)"), (axes.yaxis, "θ_o (deg)")):
        axis.set_ticks(range(0, 91, 15))
        axis.set_label_text(label, fontsize=9.5, color=INK)
    axes.set_xlim(0, 90)
    axes.set_ylim(0, 90)
    axes.tick_params(labelsize=9, colors=INK)
    bar = figure.colorbar(mesh, cax=_at(figure, 11.82, bottom + 0.72, 0.13, 3.05))
    ticks = [m * 10**k for k in range(7) for m in (1, 2, 5) if m * 10**k <= most]
    bar.set_ticks(ticks if len(ticks) <= 7 else ticks[::3], labels=[])
    bar.minorticks_off()
    bar.ax.set_ylim(1, most)
    bar.ax.set_yticks(bar.ax.get_yticks(), [f"{tick:g}" for tick in bar.ax.get_yticks()])
    bar.ax.tick_params(labelsize=8.5, colors=INK)


def _hemispheres(figure: Figure, found: Portrait) -> None:
    values = np.concatenate([disk.value for disk in found.disks])
    values = values[np.isfinite(values)]
    log = _logarithmic(values)
    low, high = _range(values, log)
    norm = LogNorm(low, high) if log else Normalize(low, high)
    side = 3.55
    drawn = [
        _disk(_at(figure, 0.25 + 3.75 * k, 0.42, side, side), disk, norm)
        for k, disk in enumerate(found.disks)
    ]  # fmt: skip
    bar = figure.colorbar(
        drawn[0], cax=_at(figure, 11.62, 0.75, 0.16, 2.9), extend="min" if log else "neither"
    )  # fmt: skip
    bar.ax.tick_params(labelsize=9, colors=INK)
    bar.ax.set_title("f_r (1/sr)", fontsize=9, color=INK)
    if log:
        bar.ax.yaxis.set_major_formatter(FuncFormatter(power_of_ten))
        bar.ax.yaxis.set_minor_formatter(NullFormatter())
    kind = "the grid's function" if found.disks[0].raster else "dots: samples"
    kind += ", small: their mirror images" if any(disk.mirrored.any() for disk in found.disks) else ""
    key = f"{kind}  ·  □ specular direction  ·  ○ light  ·  rings: θ_o"
    if any(len(disk.blind) for disk in found.disks):
        key += "  ·  orange: blind, no usable sample"
    if any(len(disk.masked) for disk in found.disks):
        key += "  ·  × masked sample"
    _words(figure, 0.25, 0.2, key)


def _disk(axes: Any, disk: Disk, norm: Normalize) -> Any:
    """One hemisphere from above: the radius is theta_o, the light on the left, its mirror on the right."""
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_xlim(-97, 97)
    axes.set_ylim(-97, 97)
    ring = np.linspace(0, 2 * np.pi, 181)
    axes.fill(90 * np.cos(ring), 90 * np.sin(ring), color=_BACKGROUND, zorder=0)
    points = _raster(axes, disk, norm) if disk.raster else _dots(axes, disk, norm)
    if len(disk.masked):
        axes.plot(*_flat(*disk.masked.T), "x", color=PURPLE, markersize=3, markeredgewidth=0.8, zorder=1)
    if len(disk.blind):
        axes.plot(*_flat(*disk.blind.T), ".", color=VERMILLION, markersize=2.2, alpha=0.8, zorder=3)
    for radius in (30, 60, 90):
        axes.plot(radius * np.cos(ring), radius * np.sin(ring), color=_QUIET, linewidth=0.6, zorder=3)
        axes.text(
            radius * math.cos(1.9), radius * math.sin(1.9), f"{radius}°", fontsize=8, color=INK, zorder=5,
            ha="center", va="center",
            bbox={"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.7},
        )  # fmt: skip
    for turn, marker in ((np.pi, "s"), (0.0, "o")):
        at = _flat(np.array([disk.theta_i_deg]), np.array([turn]))
        for colour, width in (("white", 3.2), (INK, 1.3)):
            axes.plot(
                *at, marker, color=colour, markersize=15, markeredgewidth=width, markerfacecolor="none",
                zorder=6,
            )  # fmt: skip
    azimuth = "" if disk.phi_i_deg is None else f", φ_i = {_degrees(disk.phi_i_deg)}°"
    blind = "" if not disk.blind_share else f", {percent(disk.blind_share)} blind"
    axes.set_title(f"θ_i = {_degrees(disk.theta_i_deg)}°{azimuth}{blind}", loc="left", **_TITLE)
    return points


def _dots(axes: Any, disk: Disk, norm: Normalize) -> Any:
    x, y = _flat(disk.theta_o_deg, disk.turn)
    size = np.where(disk.mirrored, 0.35, 1.0) * _marker_area(disk)
    order = np.argsort(disk.value)  # peaks on top
    return axes.scatter(
        x[order], y[order], c=disk.value[order], s=size[order], cmap=_SHADES, norm=norm, linewidths=0,
        rasterized=True, zorder=2,
    )  # fmt: skip


def _raster(axes: Any, disk: Disk, norm: Normalize) -> Any:
    theta, turn = np.unique(disk.theta_o_deg), np.unique(disk.turn)
    edges = [np.append(nodes, 2 * nodes[-1] - nodes[-2]) for nodes in (theta, turn)]
    x, y = _flat(*np.meshgrid(*(edge - 0.5 * (edge[1] - edge[0]) for edge in edges), indexing="ij"))
    value = np.ma.masked_invalid(disk.value.reshape(len(theta), len(turn)))
    return axes.pcolormesh(x, y, value, cmap=_SHADES, norm=norm, rasterized=True, zorder=2)


def _flat(theta_deg: FloatArray, turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where a direction is drawn: the light's azimuth points to the left."""
    return -theta_deg * np.cos(turn), -theta_deg * np.sin(turn)


def _marker_area(disk: Disk) -> float:
    """Area of a marker (points squared) that about fills the gap to the next one."""
    spacing = 190.0 / math.sqrt(max(len(disk.value), 1))  # the disk is about 240 points across
    return float(np.clip((0.8 * spacing) ** 2, 5.0, 70.0))


def _logarithmic(values: FloatArray) -> bool:
    positive = values[values > 0]
    peaked = len(positive) > 2 and float(positive.max()) > PEAK * float(np.median(positive))
    return peaked or is_wide(values)


def _range(values: FloatArray, log: bool) -> tuple[float, float]:
    """Smallest and largest value shown: a logarithmic scale leaves out the lowest half per cent."""
    positive = values[values > 0]
    if not len(positive):
        return 0.0, 1.0
    high = float(positive.max())
    if not log:
        return 0.0, high
    return max(float(np.quantile(positive, 0.005)), high * 10**-MOST_DECADES), high


def _radius(value: float, low: float, high: float, log: bool) -> float:
    """Where on the unit radius a value is drawn."""
    if not math.isfinite(value):
        return math.nan
    if not log:
        return value / high
    return INNER + (1 - INNER) * math.log(max(value, low) / low) / math.log(high / low)


def _ticks(low: float, high: float, log: bool) -> list[float]:
    if log:
        first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
        powers = [10.0**k for k in range(first, last + 1, 1 + max(last - first, 0) // 5)]
        return powers if len(powers) > 1 else [low, math.sqrt(low * high), high]
    step = 10.0 ** math.floor(math.log10(high))
    step = next(step * s for s in (0.1, 0.2, 0.25, 0.5, 1.0, 2.0) if high / (step * s) <= 5.5)
    return [step * k for k in range(1, math.floor(high / step + 1e-9) + 1)]


def _degrees(angle: float) -> str:
    return f"{angle:.1f}".removesuffix(".0")
