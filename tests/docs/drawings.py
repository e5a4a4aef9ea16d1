"""Makes the drawings of docs/conventions.md: ``python -m tests.docs.drawings``.

Angles in them are computed by ``fitter.directions``, so that a drawing can't show another convention than the
code has. Labels stay text, which keeps the files small and lets a browser search them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from fitter import directions
from fitter.formats import specular

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "drawings"
LIGHT, VIEW, HALF, PLAIN = "#d55e00", "#0072b2", "#009e73", "#555555"
#: Where the axes +x, +y, +z of a sketch in space point on paper.
OBLIQUE = np.array([[-0.52, -0.38], [0.95, -0.16], [0.0, 1.0]])
SETTINGS = {
    "svg.fonttype": "none",
    "svg.hashsalt": "brdf-fitter",
    "font.size": 11,
    "font.family": "DejaVu Sans",
}

Floats = NDArray[np.float64]


def paper(w: ArrayLike) -> Floats:
    """Where points in space (..., 3) stand on paper (..., 2)."""
    return np.asarray(w, np.float64) @ OBLIQUE


def panels(count: int, width: float = 4.0, height: float = 3.6) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(width * count, height), layout="tight")
    axes = list(np.atleast_1d(figure.subplots(1, count)))
    for one in axes:
        one.set_aspect("equal")
        one.axis("off")
    return figure, axes


def arrow(
    axes: Axes, end: ArrayLike, label: str, colour: str, start: ArrayLike = (0.0, 0.0), **style: object
) -> None:
    """From ``start`` to ``end`` on paper, the label beyond its tip."""
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    axes.annotate(
        "",
        end,
        start,
        arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8, "shrinkA": 0, "shrinkB": 0, **style},
    )
    away = (end - start) / max(float(np.hypot(*(end - start))), 1e-9)
    axes.text(*(end + 0.09 * away), label, color=colour, ha="center", va="center")


def arc(axes: Axes, points: ArrayLike, label: str, colour: str, off: float = 0.09) -> None:
    """A line through points (n, 2) on paper, labelled at its middle on the side away from the origin."""
    points = np.asarray(points, np.float64)
    axes.plot(points[:, 0], points[:, 1], color=colour, lw=1.2)
    middle = points[len(points) // 2]
    axes.text(
        *(middle * (1 + off / max(float(np.hypot(*middle)), 1e-9))),
        label,
        color=colour,
        ha="center",
        va="center",
    )


def from_normal(theta: float, phi: float, radius: float) -> Floats:
    """The arc of a polar angle, on paper (n, 2)."""
    return paper(radius * directions.vector_from_spherical(np.linspace(0, theta, 40), np.full(40, phi)))


def in_surface(phi: float, radius: float) -> Floats:
    """The arc of an azimuth from +x, on paper (n, 2)."""
    return paper(radius * directions.vector_from_spherical(np.full(40, np.pi / 2), np.linspace(0, phi, 40)))


def surface(axes: Axes, names: bool = True) -> None:
    corners = paper([[1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0]])
    axes.fill(corners[:, 0], corners[:, 1], color="#eeeeee", zorder=0)
    for name, tip in {
        "x, the sample's own": [1.25, 0, 0],
        "y": [0, 1.2, 0],
        "z, the normal": [0, 0, 1.25],
    }.items():
        arrow(axes, paper(tip), name if names else name.partition(",")[0], PLAIN)
    axes.set_xlim(-1.6, 1.6)
    axes.set_ylim(-0.85, 1.5)


def direction(axes: Axes, theta: float, phi: float, name: str, colour: str) -> None:
    """A direction, its foot on the surface, and both of its angles."""
    w = directions.vector_from_spherical(theta, phi)
    arrow(axes, paper(w), name, colour)
    foot = paper(w * [1, 1, 0])
    dashed = {"color": colour, "lw": 0.9, "ls": "--"}
    axes.plot(*np.stack([paper(w), foot]).T, **dashed)
    axes.plot(*np.stack([[0.0, 0.0], foot]).T, **dashed)


def frame() -> Figure:
    """theta and phi of both directions."""
    figure, (axes,) = panels(1, 5.4, 4.4)
    surface(axes)
    lit, seen = (0.75, np.radians(290.0)), (0.9, np.radians(62.0))
    direction(axes, *lit, "wi", LIGHT)
    direction(axes, *seen, "wo", VIEW)
    arc(axes, from_normal(*lit, 0.55), "θ_i", LIGHT)
    arc(axes, from_normal(*seen, 0.42), "θ_o", VIEW)
    arc(axes, in_surface(lit[1], 0.34), "φ_i", LIGHT, 0.2)
    arc(axes, in_surface(seen[1], 0.5), "φ_o", VIEW)
    return figure


def half_difference() -> Figure:
    """theta_h and phi_h in the sample's frame, theta_d and phi_d in the half vector's."""
    figure, (left, right) = panels(2, 4.6, 4.2)
    theta_h, phi_h, theta_d, phi_d = 0.55, np.radians(60.0), 0.6, np.radians(70.0)
    wi, wo = directions.vectors_from_half_difference(theta_h, theta_d, phi_d, phi_h)
    surface(left, names=False)
    direction(left, theta_h, phi_h, "h", HALF)
    arrow(left, paper(wi), "wi", LIGHT)
    arrow(left, paper(wo), "wo", VIEW)
    arc(left, from_normal(theta_h, phi_h, 0.6), "θ_h", HALF)
    arc(left, in_surface(phi_h, 0.45), "φ_h", HALF)
    left.set_title("the sample's frame", fontsize=11)
    surface(right, names=False)
    for text in right.texts:
        text.set_text({"x": "θ_h grows", "y": "", "z": "h"}.get(text.get_text(), ""))
    direction(right, theta_d, phi_d, "wi", LIGHT)
    direction(right, theta_d, phi_d + np.pi, "wo", VIEW)
    arc(right, from_normal(theta_d, phi_d, 0.55), "θ_d", PLAIN)
    arc(right, from_normal(theta_d, phi_d + np.pi, 0.55), "θ_d", PLAIN)
    arc(right, in_surface(phi_d, 0.45), "φ_d", LIGHT)
    right.set_title("the half vector's frame", fontsize=11)
    return figure


def azimuths() -> Figure:
    """The surface from above: the same pair of directions in both conventions, and about the specular ray."""
    figure, (left, middle, right) = panels(3, 3.7, 3.9)
    theta, phi_i, phi_o = 0.9, np.pi, np.radians(-51.0)
    light, viewer = (directions.vector_from_spherical(theta, phi)[:2] for phi in (phi_i, phi_o))
    for axes in (left, middle, right):
        turn = np.linspace(0, 2 * np.pi, 200)
        axes.plot(np.cos(turn), np.sin(turn), color=PLAIN, lw=1)
        axes.plot([-1, 1], [0, 0], color=PLAIN, lw=0.6, ls=":")
        axes.plot([0], [0], marker=".", color=PLAIN)
        axes.set_xlim(-1.45, 1.45)
        axes.set_ylim(-1.3, 1.3)
        arrow(axes, light, "", LIGHT)
        axes.text(-0.6, 0.13, "light", color=LIGHT, ha="center")
        axes.plot(*-light[:, None], marker="s", color=HALF)
        axes.text(0.75, 0.13, "mirror", color=HALF, ha="center")
    for axes, start in ((left, phi_i), (middle, 0.0)):
        arrow(axes, viewer, "wo", VIEW)
        end = phi_o + 2 * np.pi if start else phi_o
        sweep = np.linspace(start, end, 60)
        axes.plot(0.4 * np.cos(sweep), 0.4 * np.sin(sweep), color=VIEW, lw=1.2)
        difference = f"φ_o − φ_i = {np.degrees(end - start):.0f}°".replace("-", "−")
        axes.text(0.0, -1.25, difference, color=VIEW, ha="center")
    left.set_title("phi_specular_180", fontsize=11)
    middle.set_title("phi_specular_0", fontsize=11)
    radial, azimuth = 0.75, np.radians(55.0)
    path = specular.outgoing(theta, phi_i, np.linspace(0, radial, 40), np.full(40, azimuth))
    zero = specular.outgoing(theta, phi_i, np.linspace(0, 0.5, 40), np.zeros(40))
    turned = specular.outgoing(theta, phi_i, np.full(40, 0.35), np.linspace(0, azimuth, 40))
    for points, colour in ((path, VIEW), (zero, HALF), (turned, VIEW)):
        right.plot(points[:, 0], points[:, 1], color=colour, lw=1.6)
    right.text(*(path[-1, :2] + [-0.08, -0.16]), "wo", color=VIEW, ha="center")
    right.text(0.7, -0.62, "radial", color=VIEW, ha="left")
    right.text(0.1, -0.24, "azimuth", color=VIEW, ha="center")
    right.text(0.2, 0.08, "0", color=HALF, ha="center")
    right.set_title("about the specular ray", fontsize=11)
    return figure


def in_plane() -> Figure:
    """The plane of incidence from the side: what the sign of theta_o means."""
    figure, axes = panels(2, 4.2, 2.9)
    lit = np.radians(40.0)
    for one, name, forward in zip(axes, ("forward", "back"), (True, False), strict=True):
        one.plot([-1.25, 1.25], [0, 0], color=PLAIN, lw=3)
        arrow(one, [0, 1.12], "normal", PLAIN)
        arrow(one, [-np.sin(lit), np.cos(lit)], "light, θ_i > 0", LIGHT)
        one.plot(*np.array([[0, 0], [np.sin(lit), np.cos(lit)]]).T, color=HALF, lw=1, ls="--")
        one.text(0.78, 0.9, "mirror", color=HALF, ha="center")
        for side in (1.0, -1.0):
            theta = side * np.radians(68.0)
            sign = ">" if (side > 0) == forward else "<"
            arrow(one, [np.sin(theta), np.cos(theta)], f"θ_o {sign} 0", VIEW)
        one.set_xlim(-1.5, 1.5)
        one.set_ylim(-0.1, 1.3)
        one.set_title(name, fontsize=11)
    return figure


DRAWINGS: Mapping[str, Callable[[], Figure]] = {
    "frame": frame, "half-difference": half_difference, "azimuths": azimuths, "in-plane": in_plane,
}  # fmt: skip


def make(folder: Path) -> None:
    """Every drawing as ``folder/NAME.svg``; the same bytes from the same versions."""
    with mpl.rc_context(SETTINGS):
        for name, draw in DRAWINGS.items():
            draw().savefig(folder / f"{name}.svg", metadata={"Date": None, "Creator": None})


if __name__ == "__main__":
    make(FOLDER)
