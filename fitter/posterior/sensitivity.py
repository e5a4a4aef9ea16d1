"""offset_sensitivities: what an instrument whose angles are a little off does to the estimates.

The estimates solve G(p; directions) = 0, the gradient of the objective. An offset d of an angle moves them by
dp/dd = -H^-1 dG/dd, H being the exact curvature (implicit function theorem; GUM 5.1.3 calls the result a
sensitivity coefficient). Weights and targets stay what they are for the directions as stated.

An offset adds to theta_i, theta_o or the azimuth between the two of every sample. A table with all directions
in the plane of incidence comes from an arm whose theta_o has a sign: positive on the specular side.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitter.compression import CompressedTable
from fitter.fitting.blocks import BLOCK, padded
from fitter.fitting.chunks import CHUNK
from fitter.fitting.covariance import settled, to_natural
from fitter.fitting.layout import channel_groups, layout
from fitter.fitting.polish import normal_equations
from fitter.fitting.result import FitResult
from fitter.fitting.sums import scan_sums
from fitter.posterior.jackknife import free_curvature, used_by, vector
from fitter.posterior.offsets import ANGLES, shifted, tangents
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Radians of the central difference.
STEP = 1e-5


def offset_sensitivities(table: Table | CompressedTable, fit: FitResult) -> dict[str, FloatArray]:
    """By flat label, (3,): derivative of the estimate with an offset (radians) of theta_i, theta_o and phi.

    NaN where the fit states no uncertainty. Of a large table an evenly spaced part is looked at.

    Raises
    ------
    SpecError : the table lacks a channel of the fit.
    """
    whole = table.decompress() if isinstance(table, CompressedTable) else table
    data = used_by(whole, fit)
    rows, _ = data.evenly(BLOCK // 2)
    rows = rows if len(rows) <= BLOCK else rows[np.linspace(0, len(rows) - 1, BLOCK).astype(np.intp)]
    places = layout(fit.spec, len(data.channels))
    found: dict[str, FloatArray] = {}
    for group in channel_groups(fit.spec, len(data.channels)):
        floor = data.floor[list(group)]
        p, labels = vector(places, fit, group)
        block = data.part(group, rows, max(CHUNK, padded(len(rows))))
        p, matrix, free = settled(
            places, p, normal_equations(places, data.metric, floor, p, [block]), len(group)
        )
        jacobian = np.asarray(to_natural(places, len(group), p)[1])
        one = np.zeros(len(rows), np.intp)

        def gradient(pair: FloatArray) -> tuple[FloatArray, FloatArray]:
            sums = scan_sums(places, data.metric, floor, p, replace(block, pair=pair), one, 1)  # noqa: B023
            return sums.scores[0], sums.slopes[0]

        where = np.flatnonzero(free)
        curvature, _ = free_curvature(gradient(block.pair)[1], matrix, where)
        inverse = jacobian[:, where] @ np.linalg.pinv(curvature, hermitian=True)
        slopes = np.empty((len(labels), len(ANGLES)))
        tangent = tangents(block.pair, signed=whole.domain.in_plane)
        for k, step in enumerate(STEP * np.eye(len(ANGLES))):
            ends = [
                gradient(np.asarray(shifted(block.pair, tangent, side * step)))[0] for side in (1.0, -1.0)
            ]
            slopes[:, k] = -inverse @ ((ends[0] - ends[1]) / (2.0 * STEP))[where]
        for label, row in zip(labels, slopes, strict=True):
            stated = np.isfinite(fit.covariance[fit.labels.index(label), fit.labels.index(label)])
            found[label] = row if stated else np.full(len(ANGLES), np.nan)
    return {label: found[label] for label in fit.labels}
