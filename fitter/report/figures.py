"""Figures of a report, drawn from its record as SVG data URIs; the object API only (server threads)."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from fitter.report.palette import colours
from fitter.report.rounding import significant

Record = Mapping[str, Any]

MARKERS = ("o", "s", "^", "D")
LINES = ("-", "--", "-.", ":")
INK, GRID = "#222222", "#dddddd"
WIDTH, HEIGHT = 4.6, 3.2
DPI = 200
#: Relative residuals that spread wider than this are drawn linear to 1 and logarithmic beyond.
SYMLOG = 4.0


@dataclass(frozen=True)
class Picture:
    """One figure, what it shows in words, and as what a page has it."""

    figure: Figure
    alt: str
    kind: Literal["svg", "png"]

    @cached_property
    def uri(self) -> str:
        """The figure as a data URI; in an SVG, dense layers are rasterised by their artists."""
        stream = io.BytesIO()
        dated = {"Date": None} if self.kind == "svg" else None
        self.figure.savefig(stream, format=self.kind, dpi=DPI, metadata=dated)
        media = {"svg": "image/svg+xml", "png": "image/png"}[self.kind]
        return f"data:{media};base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"

    @property
    def width(self) -> int:
        """CSS pixels."""
        return round(96 * self.figure.get_size_inches()[0])

    @property
    def height(self) -> int:
        """CSS pixels."""
        return round(96 * self.figure.get_size_inches()[1])


def panel(title: str, x: str, y: str) -> tuple[Figure, Axes]:
    """An empty figure of one pair of axes in the report's style."""
    figure = Figure(figsize=(WIDTH, HEIGHT), facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    # Fixed margins: laying out anew what always looks the same takes a third of the drawing time.
    figure.subplots_adjust(left=0.165, right=0.975, bottom=0.16, top=0.91)
    styled(axes)
    axes.set_title(plain(title), fontsize=10, color=INK, loc="left", fontweight="bold")
    axes.set_xlabel(plain(x), fontsize=10, color=INK)
    axes.set_ylabel(plain(y), fontsize=10, color=INK)
    return figure, axes


def styled(axes: Axes) -> None:
    axes.tick_params(labelsize=9, colors=INK)
    axes.grid(True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def logarithmic(axes: Axes) -> None:
    """A logarithmic y axis with plain text for its powers (matplotlib would parse a formula for each)."""
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(power_of_ten))
    axes.yaxis.set_minor_formatter(NullFormatter())


def power_of_ten(value: float, position: int | None = None) -> str:
    del position
    if not value > 0:
        return "0"
    return significant(value, 1) if 0.001 <= value < 10_000 else f"1e{round(math.log10(value))}"


def picture(figure: Figure, alt: str, kind: Literal["svg", "png"] = "svg") -> Picture:
    """The figure as a page has it."""
    return Picture(figure, alt, kind)


def plain(text: str, longest: int = 60) -> str:
    """Text that a figure can show: names come from strangers, and "$" would start a formula."""
    shown = "".join(c if c.isprintable() and (ord(c) < 0x500 or c in "—−×≥≤²₀°") else "?" for c in text)
    shown = shown if len(shown) <= longest else shown[: longest - 1] + "…"
    return shown.replace("$", r"\$")


def legend(axes: Axes, **keywords: Any) -> None:
    axes.legend(fontsize=8.5, frameon=True, framealpha=0.85, edgecolor=GRID, **keywords)


def residual_pictures(record: Record) -> list[Picture]:
    """One picture per angle: points, medians and the central 90 % per channel."""
    section = record["residuals"]
    names = [name for name in section["shown"] if _any(section["relative"][name])]
    colour = colours(section["shown"])
    found: list[Picture] = []
    for angle in section["angles"].values():
        label = angle["label"]
        figure, axes = panel(f"Residual against {label}", f"{label} (deg)", "relative residual")
        axes.axhline(0, color=INK, linewidth=0.8)
        edges: list[float] = []
        for k, name in enumerate(names):
            y, binned = _floats(section["relative"][name]), angle["binned"][name]
            axes.plot(
                _floats(angle["points"]), y, ".",
                color=colour[name], markersize=2, alpha=0.25, rasterized=True, zorder=1,
            )  # fmt: skip
            at, lower, upper = (_floats(binned[end]) for end in ("angle", "lower", "upper"))
            axes.fill_between(at, lower, upper, color=colour[name], alpha=0.13)
            axes.plot(
                binned["angle"], binned["median"], LINES[k], marker=MARKERS[k], color=colour[name],
                markersize=4, linewidth=1.6, label=plain(name, 24), zorder=3,
            )  # fmt: skip
            edges += [*binned["lower"], *binned["upper"]]
        if names:
            low, high = _residual_limits(edges)
            if high - low > SYMLOG:
                axes.set_yscale("symlog", linthresh=1.0)
            axes.set_ylim(low, high)
            legend(axes, loc="best", title="median", title_fontsize=8.5)
        else:
            _nothing(axes, "no relative residual: every value is zero")
        found.append(picture(figure, f"Relative residual against {label}, with binned medians per channel."))
    return found


def map_pictures(record: Record) -> list[Picture]:
    """Median residual over two angles, one picture per pair of angles and shown channel, one colour scale for
    all."""
    section = record["residuals"]
    areas, found = [section["map"], *section.get("further_maps", [])], []
    label = {name: angle["label"] for name, angle in section["angles"].items()}
    label["theta_o_signed"] = "θ_o, positive on the specular side"
    label["phi"] = "azimuth from the mirror direction φ"
    known = np.concatenate([np.abs(_floats(m)).ravel() for area in areas for m in area["median"].values()])
    known = known[np.isfinite(known)]
    limit = float(np.clip(np.quantile(known, 0.95), 0.01, 1.0)) if len(known) else 1.0
    for area, name in ((area, name) for area in areas for name in section["shown"]):
        figure, axes = panel(
            f"Residual map, {name}", f"{label[area['x']]} (deg)", f"{label[area['y']]} (deg)"
        )
        figure.subplots_adjust(right=0.79)
        axes.grid(False)
        mesh = axes.pcolormesh(
            _floats(area["x_edges"]), _floats(area["y_edges"]),
            np.ma.masked_invalid(_floats(area["median"][name])),
            cmap="PuOr_r", vmin=-limit, vmax=limit, rasterized=True,
        )  # fmt: skip
        beside = figure.add_axes((0.815, 0.16, 0.022, 0.75))  # as high as the map
        bar = figure.colorbar(mesh, cax=beside, extend="both", ticks=MaxNLocator(5, steps=[1, 2, 5, 10]))
        bar.set_label("median relative residual", fontsize=9, color=INK)
        bar.ax.tick_params(labelsize=8.5, colors=INK)
        axes.set_facecolor("#c4c9ce")
        alt = f"Map of the median relative residual of channel {name}; grey where nothing was measured."
        found.append(picture(figure, alt))
    return found


def slice_pictures(record: Record) -> list[Picture]:
    """One picture per incidence: measured points, the fitted curve, the predictive band."""
    section = record["slices"]
    colour = colours(section["channels"])
    found: list[Picture] = []
    for cut in section["slices"]:
        incidence = f"{cut['theta_i_deg']:.1f}".removesuffix(".0")
        figure, axes = panel(
            f"Slice at θ_i = {incidence}°", "θ_o (deg), positive on the specular side", "f (1/sr)"
        )
        log = cut["axis"] == "log"
        positive: list[float] = []
        for k, name in enumerate(section["channels"]):
            x, fit = _floats(cut["curve"]["theta_o_deg"]), _floats(cut["curve"]["fit"][name])
            measured = _floats(cut["points"]["measured"][name])
            if cut["curve"].get("predictive_lower") is not None:
                lower, upper = (
                    _floats(cut["curve"][end][name]) for end in ("predictive_lower", "predictive_upper")
                )
                axes.fill_between(x, lower, upper, color=colour[name], alpha=0.10, linewidth=0)
                for edge in (lower, upper):
                    axes.plot(x, edge, color=colour[name], alpha=0.45, linewidth=0.6)
            if cut["curve"]["lower"] is not None:
                lower, upper = (_floats(cut["curve"][end][name]) for end in ("lower", "upper"))
                axes.fill_between(x, lower, upper, color=colour[name], alpha=0.18, linewidth=0)
            axes.plot(
                _floats(cut["points"]["theta_o_deg"]),
                np.where(measured > 0, measured, np.nan) if log else measured,
                MARKERS[k], color=colour[name], markersize=3.2, markerfacecolor="none", markeredgewidth=0.8,
            )  # fmt: skip
            axes.plot(x, fit, LINES[k], color=colour[name], linewidth=1.6)
            axes.plot(
                [], [], LINES[k], marker=MARKERS[k], color=colour[name], markersize=3.2,
                markerfacecolor="none", linewidth=1.6, label=plain(name, 24),
            )  # fmt: skip
            positive += [*measured[measured > 0], *fit[fit > 0]]
        if log and positive:
            logarithmic(axes)
            axes.set_ylim(max(min(positive) / 1.6, max(positive) * 1e-7), max(positive) * 1.6)
        axes.axvline(cut["theta_i_deg"], color=INK, linewidth=0.9, linestyle=(0, (4, 3)), zorder=0)
        axes.xaxis.set_major_locator(MaxNLocator(7, integer=True))
        legend(axes, loc="best")
        band = " and its 95 % predictive band" if section["level"] is not None else ""
        found.append(
            picture(
                figure,
                f"Measured values (markers), fit (line){band} in the plane of incidence at {incidence} "
                "degrees; the dashed vertical line marks the specular direction.",
            )
        )
    return found


def reflectance_picture(record: Record) -> Picture:
    section = record["reflectance"]
    colour = colours(section["shown"])
    figure, axes = panel("Directional-hemispherical reflectance", "θ_i (deg)", "reflectance")
    theta = [row["theta_i_deg"] for row in section["rows"]]
    values = np.array([_floats(row["reflectance"]) for row in section["rows"]])
    outside = np.array([row["extrapolated"] for row in section["rows"]])
    axes.axhline(1, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
    for k, name in enumerate(section["shown"]):
        column = values[:, section["channels"].index(name)]
        axes.plot(theta, column, LINES[k], color=colour[name], linewidth=1.4, label=plain(name, 24))
        for inside, face in ((~outside, colour[name]), (outside, "white")):
            axes.plot(
                np.array(theta)[inside], column[inside], MARKERS[k], color=colour[name], markerfacecolor=face,
                markersize=5,
            )  # fmt: skip
    if np.nanmax(values, initial=0.0) > 20:
        logarithmic(axes)
    else:
        axes.set_ylim(0, 1.12 * float(np.nanmax(values, initial=1e-3)))
    axes.set_xlim(-2, 90)
    legend(axes, loc="best")
    return picture(
        figure,
        "Directional-hemispherical reflectance of the fitted model against incidence; open markers are "
        "extrapolated, the dashed line is 1.",
    )


def correlation_picture(record: Record) -> Picture | None:
    section = record["correlation"]
    count = len(section["labels"])
    if count < 2:
        return None
    side = min(2.4 + 0.42 * count, 8.0)
    figure = Figure(figsize=(side + 0.8, side), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    matrix = _floats(section["matrix"])
    image = axes.imshow(matrix, cmap="PuOr_r", vmin=-1, vmax=1)
    labels = [plain(label, 18) for label in section["labels"]]
    axes.set_xticks(range(count), labels, rotation=60, ha="right", rotation_mode="anchor", fontsize=9)
    axes.set_yticks(range(count), labels, fontsize=9)
    if count <= 12:
        for i in range(count):
            for j in range(count):
                dark = abs(matrix[i, j]) > 0.6
                axes.text(
                    j, i, f"{matrix[i, j]:.2f}", ha="center", va="center", fontsize=8,
                    color="white" if dark else INK,
                )  # fmt: skip
    bar = figure.colorbar(image, ax=axes, shrink=0.8)
    bar.set_label("correlation", fontsize=9)
    return picture(figure, "Correlation matrix of the estimates.")


def _residual_limits(edges: Sequence[float]) -> tuple[float, float]:
    """Limits that hold the central 90 % of every bin, and zero."""
    known = _floats(edges)
    known = known[np.isfinite(known)]
    low, high = min(0.0, float(known.min())), max(0.0, float(known.max()))
    pad = 0.12 * (high - low) or 0.01
    return low - pad, high + pad


def _nothing(axes: Axes, why: str) -> None:
    axes.text(0.5, 0.5, why, ha="center", va="center", fontsize=9, color=INK, transform=axes.transAxes)


def _any(values: Sequence[float | None]) -> bool:
    return any(v is not None for v in values)


def _floats(nested: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """What the record holds as an array; None becomes NaN."""
    return np.asarray(nested, dtype=np.float64)
