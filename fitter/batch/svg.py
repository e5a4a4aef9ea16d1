"""Plots of one batch's index, written as SVG by hand: a plotting library takes longer than the fit does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Pixels: a panel, and what is left of it for labels (left, right, top, bottom).
WIDTH, HEIGHT = 230, 150
_LEFT, _RIGHT, _TOP, _BOTTOM = 40, 8, 16, 20
_STYLE = (
    "text{font:10px sans-serif;fill:#3a4252}.t{font-weight:bold}.g{stroke:#dfe3ea;fill:none}"
    ".p{fill:none;stroke-linecap:round;stroke-width:2.4;stroke-opacity:.45}"
    ".l{fill:none;stroke-width:1.5}.z{stroke:#3a4252;stroke-width:.8;fill:none}.b{fill-opacity:.16}"
)


@dataclass
class Panel:
    """A pair of axes; coordinates are already in the axes' scales. What lies outside is drawn at the edge.

    x, y : (low, high) of the axes. ticks : (position, label).
    """

    title: str
    x: tuple[float, float]
    y: tuple[float, float]
    x_ticks: Sequence[tuple[float, str]]
    y_ticks: Sequence[tuple[float, str]]
    parts: list[str] = field(default_factory=list[str])

    def dots(self, x: FloatArray, y: FloatArray, colour: str) -> None:
        """A dot for each pair that is finite."""
        path = "".join(f"M{a:g} {b:g}h0" for a, b in self._places(x, y))
        self.parts.append(f'<path class="p" stroke="{colour}" d="{path}"/>')

    def line(self, x: FloatArray, y: FloatArray, colour: str) -> None:
        """A line through the pairs that are finite."""
        path = "L".join(f"{a:g} {b:g}" for a, b in self._places(x, y))
        if path:
            self.parts.append(f'<path class="l" stroke="{colour}" d="M{path}"/>')

    def band(self, x: FloatArray, lower: FloatArray, upper: FloatArray, colour: str) -> None:
        """The area between two lines."""
        ends = [*self._places(x, lower), *reversed(self._places(x, upper))]
        path = "L".join(f"{a:g} {b:g}" for a, b in ends)
        if path:
            self.parts.append(f'<path class="b" fill="{colour}" d="M{path}z"/>')

    def mark(self, at: float) -> None:
        """A dashed vertical line; none where that lies outside: at the edge it would say another number."""
        if not self.x[0] <= at <= self.x[1]:
            return
        ((across, _),) = self._places(np.array([at]), np.array([self.y[0]]))
        self.parts.append(
            f'<path class="z" stroke-dasharray="4 3" d="M{across:g} {_TOP}V{HEIGHT - _BOTTOM}"/>'
        )

    def _places(self, x: FloatArray, y: FloatArray) -> list[tuple[float, float]]:
        """Pixels of the pairs that are finite."""
        fine = np.isfinite(x) & np.isfinite(y)
        across = _share(x[fine], self.x) * (WIDTH - _LEFT - _RIGHT) + _LEFT
        down = (1 - _share(y[fine], self.y)) * (HEIGHT - _TOP - _BOTTOM) + _TOP
        return list(zip(across.round(1).tolist(), down.round(1).tolist(), strict=True))

    def drawn(self, shift: float) -> str:
        """The panel as an SVG group."""
        found: list[str] = []
        for at, label in self.y_ticks:
            ((_, down),) = self._places(np.array([self.x[0]]), np.array([at]))
            found.append(f'<path class="g" d="M{_LEFT} {down:g}H{WIDTH - _RIGHT}"/>')
            found.append(f'<text x="{_LEFT - 4}" y="{down + 3.5:g}" text-anchor="end">{escape(label)}</text>')
        for at, label in self.x_ticks:
            ((across, _),) = self._places(np.array([at]), np.array([self.y[0]]))
            found.append(f'<text x="{across:g}" y="{HEIGHT - 7}" text-anchor="middle">{escape(label)}</text>')
        found.append(f'<path class="z" d="M{_LEFT} {_TOP}V{HEIGHT - _BOTTOM}H{WIDTH - _RIGHT}"/>')
        title = f'<text class="t" x="{_LEFT}" y="11">{escape(self.title)}</text>'
        return f'<g transform="translate({shift:g})">{title}{"".join([*found, *self.parts])}</g>'


def document(panels: Sequence[Panel]) -> str:
    """The panels side by side, as an SVG file."""
    groups = "".join(panel.drawn(k * WIDTH) for k, panel in enumerate(panels))
    width = WIDTH * len(panels)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{HEIGHT}" '
        f'viewBox="0 0 {width} {HEIGHT}"><style>{_STYLE}</style>{groups}</svg>\n'
    )


def _share(values: FloatArray, ends: tuple[float, float]) -> FloatArray:
    return np.clip((values - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)
