"""Figures of a posterior: the corner plot and how it converged."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fitter.report import figures
from fitter.report.figures import INK, Picture, Record, picture, plain
from fitter.report.palette import BLUE, VERMILLION

#: Fewer draws than this make no density.
FEWEST_DRAWS = 50


def corner_picture(record: Record) -> Picture | None:
    """Every pair of the shown parameters; contours hold 39 % and 86 % of the draws (1 and 2 sigma in 2-D)."""
    # corner loads pyplot, which nothing else here does: a figure of its own keeps pyplot without state.
    import corner

    section = record["posterior"]["corner"]
    labels, draws = section["labels"], np.array(section["draws"], dtype=np.float64).T
    if not labels or len(draws) < max(FEWEST_DRAWS, len(labels) + 1):
        return None
    side = max(4.6, 1.75 * len(labels))
    figure = Figure(figsize=(side, side), facecolor="white")
    FigureCanvasAgg(figure)
    corner.corner(
        draws, fig=figure, labels=[plain(label, 18) for label in labels], color=BLUE, truth_color=VERMILLION,
        truths=section["estimates"], bins=24, smooth=1.0, max_n_ticks=3, labelpad=0.12, use_math_text=True,
        label_kwargs={"fontsize": 10, "color": INK}, quantiles=[0.025, 0.5, 0.975],
        levels=(0.393, 0.865), data_kwargs={"alpha": 0.2}, pcolor_kwargs={"rasterized": True}, quiet=True,
    )  # fmt: skip
    figure.subplots_adjust(left=0.12, bottom=0.12, right=0.97, top=0.97)
    for axes in figure.axes:
        axes.tick_params(labelsize=8, colors=INK)
    return picture(
        figure,
        "Corner plot of the posterior: the density of each parameter with its median and 95 % credible "
        "interval, and of each pair; lines mark the least-squares estimates.",
        "png",  # a few hundred thousand contour vertices make a slow SVG
    )


def joint_picture(record: Record) -> Picture | None:
    """The joint 95 % ellipse of the two most correlated parameters inside the box of their own intervals."""
    joint = record["budget"]["joint"] if "budget" in record else None
    if joint is None:
        return None
    figure, axes = figures.panel("Joint 95 % region", joint["a"], joint["b"])
    x, y = joint["ellipse"]
    axes.fill(x, y, color=BLUE, alpha=0.15, linewidth=0)
    axes.plot(x, y, color=BLUE, linewidth=1.6)
    axes.plot(*joint["centre"], "+", color=VERMILLION, markersize=11, markeredgewidth=1.6)
    for centre, u, line in zip(joint["centre"], joint["u"], (axes.axvline, axes.axhline), strict=True):
        for side in (-1.96, 1.96):
            line(centre + side * u, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    return picture(
        figure,
        f"Ellipse of the joint 95 % region of {joint['a']} and {joint['b']}; dashed lines are the ends of "
        "each one's own 95 % interval.",
    )


def convergence_pictures(record: Record) -> list[Picture]:
    """R-hat and effective sample size as the run went on, each with its target."""
    section = record["posterior"]
    history: list[dict[str, Any]] = section["history"]
    found: list[Picture] = []
    targets = section["targets"]
    for key, title, y, target, better in (
        ("rhat", "Largest R-hat", "R-hat − 1", targets["rhat"] - 1, "below"),
        ("ess", "Smallest effective sample size", "effective sample size", targets["ess"], "above"),
    ):
        rows = [(h.get("steps"), h.get(key)) for h in history]
        points = np.array([(s, v) for s, v in rows if s is not None and v is not None], dtype=np.float64)
        if not len(points):
            continue
        values = points[:, 1] - 1 if key == "rhat" else points[:, 1]
        figure, axes = figures.panel(title, "steps per walker", y)
        axes.plot(points[:, 0], np.maximum(values, 1e-6), "-o", color=BLUE, markersize=4, linewidth=1.6)
        axes.axhline(target, color=VERMILLION, linestyle="--", linewidth=1.4, label="target")
        figures.logarithmic(axes)
        figures.legend(axes, loc="best")
        alt = f"{title} against steps; converged when {better} the dashed target line."
        found.append(picture(figure, alt))
    return found
