"""A report built and drawn, against one plain Matplotlib figure."""

from __future__ import annotations

import io
from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure as Canvas

import fitter
from fitter import datasets, report
from tests.bench.measuring import Row, Size, alternate

TABLE = "glossy_paint"


def run(size: Size) -> Iterator[Row]:
    table = fitter.load(datasets.sample(TABLE))
    fit = fitter.fit(table, "torrance_sparrow")

    def draw() -> int:
        """Measured and fitted values against theta_o, one panel a channel."""
        canvas = Canvas(figsize=(9, 3))
        theta = np.rad2deg(np.arccos(table.wo[:, 2]))
        fitted = np.asarray(fit.model.evaluate(table.wi, table.wo))
        for k, axes in enumerate(canvas.subplots(1, 3)):
            axes.semilogy(theta, table.value[:, k], ".", theta, fitted[:, k], "x")
        out = io.StringIO()
        canvas.savefig(out, format="svg")
        return len(out.getvalue())

    times = alternate({"ours": lambda: report.build(table, fit).html(), "figure": draw}, size.pick(3, 1))
    yield Row(
        case=f"report on {TABLE}, record and page",
        ours=times["ours"].seconds("report.build and html"),
        others=(times["figure"].seconds("one Matplotlib figure of three panels"),),
        facts={"samples": len(table), "page_bytes": len(times["ours"].result)},
    )
