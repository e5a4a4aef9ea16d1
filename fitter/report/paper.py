"""Paper: A4 pages that fill from top to bottom with headings, text, tables and pictures."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from fitter.report.figures import GRID, INK, Picture

WIDTH, HEIGHT, MARGIN = 8.27, 11.69, 0.75
DPI = 200
#: Mean width of a character and height of a line, in units of the type size.
WIDE, LINE = 0.53, 1.45
#: What the fonts that come with matplotlib have beyond Latin and Greek.
KNOWN = "—–−×≥≤≈∞…→·°²³¹⁰⁴⁵⁶⁷⁸⁹⁻⁺₀₁₂₃√✓✗“”‘’ "


class Paper:
    """One document. ``footer`` stands at the bottom of every page, with its number."""

    def __init__(self, title: str, footer: str) -> None:
        self._title, self._footer = title, safe(footer)
        self.pages: list[Figure] = []
        self._y = 0.0
        self._begin()

    def heading(self, text: str, size: float = 13.0, colour: str = INK, room: float = 1.2) -> None:
        """A heading that is never the last thing on a page."""
        self._room(room + size * LINE / 72)
        self._y -= 0.12
        self._lines([text], size, colour, weight="bold")
        self._y -= 0.04

    def text(self, text: str, size: float = 9.0, colour: str = INK, indent: float = 0.0) -> None:
        """A paragraph."""
        wide = max(10, int((WIDTH - 2 * MARGIN - indent) * 72 / (WIDE * size)))
        lines = [part for line in text.splitlines() for part in textwrap.wrap(line, wide) or [""]]
        self._lines(lines, size, colour, indent=indent)
        self._y -= 0.06

    def table(
        self, head: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1, size: float = 8.0
    ) -> None:
        """A table; the first ``left`` columns are text, the others numbers. Its head is repeated."""
        cells = [[safe(cell) for cell in row] for row in (head, *rows)]
        # Bold letters are wider.
        need = [
            max(1.15 * len(cells[0][k]), *(len(row[k]) for row in cells[1:]), 1) + 2 for k in range(len(head))
        ]  # fmt: skip
        size = min(size, (WIDTH - 2 * MARGIN) * 72 / (WIDE * sum(need)))
        unit, step = WIDE * size / 72, LINE * size / 72
        starts = MARGIN + unit * np.concatenate([[0], np.cumsum(need)])
        last = starts[-1]

        def line(row: Sequence[str], weight: str) -> None:
            self._y -= step
            for k, cell in enumerate(row):
                x = starts[k] if k < left else starts[k + 1] - unit
                self._write(x, cell, size, INK, weight, "left" if k < left else "right")

        def rule(thick: float) -> None:
            y = (self._y - 0.35 * step) / HEIGHT
            self._page.add_artist(_rule(MARGIN / WIDTH, float(last) / WIDTH, y, thick))

        self._room(3 * step)
        line(cells[0], "bold")
        rule(0.9)
        self._y -= 0.25 * step
        for row in cells[1:]:
            if self._y - step < MARGIN:
                self._begin()
                line(cells[0], "bold")
                rule(0.9)
                self._y -= 0.25 * step
            line(row, "normal")
        rule(0.4)
        self._y -= 0.16

    def pictures(self, pictures: Sequence[Picture | None], *, across: int = 2, tallest: float = 8.0) -> None:
        """Pictures in rows of so many."""
        shown = [one for one in pictures if one is not None]
        gap = 0.15
        each = (WIDTH - 2 * MARGIN - gap * (across - 1)) / across
        for start in range(0, len(shown), across):
            row = shown[start : start + across]
            sizes = [one.figure.get_size_inches() for one in row]
            factors = [min(1.0, each / w, tallest / h) for w, h in sizes]
            height = max(f * h for f, (_, h) in zip(factors, sizes, strict=True))
            self._room(height)
            for k, (one, factor, (w, h)) in enumerate(zip(row, factors, sizes, strict=True)):
                x, wide, tall = MARGIN + k * (each + gap), factor * w, factor * h
                place = (x / WIDTH, (self._y - tall) / HEIGHT, wide / WIDTH, tall / HEIGHT)
                axes = self._page.add_axes(place)
                axes.set_axis_off()
                axes.imshow(_pixels(one.figure), aspect="auto", interpolation="none")
            self._y -= height + 0.12

    def bytes(self) -> bytes:
        """The document: the same record always gives the same bytes."""
        stream = io.BytesIO()
        told = {"Title": self._title, "Creator": "brdf-fitter", "CreationDate": None}
        with PdfPages(stream, metadata=told) as pdf:
            for number, page in enumerate(self.pages, start=1):
                page.text(
                    MARGIN / WIDTH, 0.4 / HEIGHT, f"{self._footer}", fontsize=7, color="#666666", va="bottom"
                )
                page.text(
                    1 - MARGIN / WIDTH, 0.4 / HEIGHT, f"{number} / {len(self.pages)}", fontsize=7,
                    color="#666666", ha="right", va="bottom",
                )  # fmt: skip
                pdf.savefig(page)
        return stream.getvalue()

    @property
    def _page(self) -> Figure:
        return self.pages[-1]

    def _begin(self) -> None:
        page = Figure(figsize=(WIDTH, HEIGHT), facecolor="white", dpi=DPI)
        FigureCanvasAgg(page)
        self.pages.append(page)
        self._y = HEIGHT - MARGIN

    def _room(self, height: float) -> None:
        if self._y - height < MARGIN and self._y < HEIGHT - MARGIN:
            self._begin()

    def _lines(
        self, lines: Sequence[str], size: float, colour: str, *, weight: str = "normal", indent: float = 0.0
    ) -> None:
        step = LINE * size / 72
        for line in lines:
            self._room(step)
            self._y -= step
            self._write(MARGIN + indent, safe(line), size, colour, weight, "left")

    def _write(self, x: float, text: str, size: float, colour: str, weight: str, side: str) -> None:
        self._page.text(
            x / WIDTH, self._y / HEIGHT, text, fontsize=size, color=colour, fontweight=weight, ha=side,
            va="baseline", parse_math=False,
        )  # fmt: skip


def safe(text: str) -> str:
    """Text that the fonts have glyphs for: names come from strangers."""
    return "".join(c if c.isprintable() and (ord(c) < 0x500 or c in KNOWN) else "?" for c in text)


def _rule(x0: float, x1: float, y: float, thick: float) -> Line2D:
    return Line2D([x0, x1], [y, y], color=INK if thick > 0.5 else GRID, linewidth=thick)


def _pixels(figure: Figure) -> NDArray[np.uint8]:
    """The figure as (height, width, 4)."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba(), np.uint8)
