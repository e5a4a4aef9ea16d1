"""bands: several processes of the residuals of each channel, and those that do best.

No one scale suits every table: misfits grow with the value, or by orders of magnitude, or live at one peak.
So several are tried, and judged by what they leave out (:mod:`fitter.posterior.process`). A few samples at
the peak decide that, more by chance than by merit: the ends of a band are the means over the best few. The
interval score is convex in them, so that of the mean is at most the mean score.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from fitter.posterior.correlated import distances, matern
from fitter.posterior.process import JITTER, Nearby, Process, Scale, conditioned

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]
#: Samples that the correlation is estimated from, and that a process is conditioned on, at most.
ESTIMATED_FROM, CONDITIONED_ON = 350, 1_000
#: Nearest neighbours whose residuals say how large they are here; 0: the scale alone does.
NEIGHBOURS = (0, 8, 24)
#: Processes that make a band.
KEPT = 3
RANGES = np.geomspace(0.05, 3.0, 18)
SHARES = (0.0, 0.3, 0.6, 0.8, 0.9, 0.97, 0.99, 0.997, 0.999)
#: Residuals below this share of a typical value are rounding.
ROUNDING = 1e-12
#: The value below which asinh is linear rather than a logarithm: this quantile of the magnitudes.
SMALL = 0.05


def chosen(
    y: FloatArray, f: FloatArray, at: FloatArray, moved: FloatArray, ends: tuple[FloatArray, FloatArray],
    scans: Sequence[IndexArray | None],
) -> list[list[list[Process]]]:
    """The best processes of each channel (C) for each of ``scans``: None, or the (n,) scan of every sample.

    y, f : (n, C) measured and fitted values in random order, at features (n, 4). moved : (m, Q, C) what the
    parameters do to the first of them, at most ``CONDITIONED_ON``. ends : (C,) each, the smallest value
    that was measured, or 0, and the largest.
    """
    used, few = min(CONDITIONED_ON, len(y)), min(ESTIMATED_FROM, len(y))
    tried = [
        [one for scale in _scales(own, fitted) for one in _measured(scale, own, fitted, at)]
        for own, fitted in zip(y.T, f.T, strict=True)
    ]
    columns = np.stack([z[:few] for channel in tried for _, _, z in channel], axis=1)
    correlations = iter(_likeliest(columns, distances(at[:few], at[:few])))
    distance = distances(at[:used], at[:used])
    found: list[list[list[Process]]] = []
    for c, channel in enumerate(tried):
        processes = [
            conditioned(
                scale, nearby, z[:used], f[:used, c], at[:used], moved[:, :, c], distance,
                *next(correlations), (float(ends[0][c]), float(ends[1][c])),
            )
            for scale, nearby, z in channel
        ]  # fmt: skip
        found.append([])
        for scan in scans:
            judged = [one.left_out(y[:used, c], f[:used, c], scan) for one in processes]
            found[-1].append([one for one, _ in sorted(judged, key=lambda pair: pair[1])[:KEPT]])
    return found


def _scales(y: FloatArray, f: FloatArray) -> tuple[Scale, Scale]:
    typical = max(float(np.median(np.abs(f))), 1e-300)
    small = max(float(np.quantile(np.abs(y), SMALL)), ROUNDING * typical)
    logarithmic = Scale(1.0, small, asinh=True)
    spread = float(np.sqrt(np.mean(np.square(logarithmic.scaled(y, f)))))
    return _likeliest_scale(y - f, f), replace(logarithmic, relative=max(spread, ROUNDING))


def _measured(
    scale: Scale, y: FloatArray, f: FloatArray, at: FloatArray
) -> Iterator[tuple[Scale, Nearby, FloatArray]]:
    z = scale.scaled(y, f)
    for count in NEIGHBOURS:
        nearby = Nearby(at, np.square(z), count)
        yield scale, nearby, z / nearby.size(at)


def _likeliest_scale(residual: FloatArray, f: FloatArray) -> Scale:
    """r and e of the scale sqrt((r f)^2 + e^2), by maximum likelihood of independent normal residuals."""
    typical = max(float(np.median(np.abs(f))), 1e-300)
    unit = np.square(residual / typical)
    level = np.square(f / typical)

    def loss(logs: FloatArray) -> float:
        variance = np.exp(2.0 * logs[0]) * level + np.exp(2.0 * logs[1]) + ROUNDING**2
        return float(np.mean(unit / variance + np.log(variance)))

    begin = np.log(max(float(np.sqrt(np.mean(unit))), ROUNDING)) + np.array([-0.5, -1.0])
    found = optimize.minimize(loss, begin, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-6})
    relative, floor = np.exp(found.x)
    return Scale(float(relative), float(np.hypot(floor, ROUNDING) * typical))


def _likeliest(z: FloatArray, distance: FloatArray) -> list[tuple[float, float]]:
    """Range and share of the correlation under which scaled residuals (n, K) are likeliest, their size taken
    out, by column. One decomposition of a field serves all shares and columns."""
    n, columns = z.shape
    best, chosen = np.full(columns, -np.inf), [(float(RANGES[0]), 0.0)] * columns
    for reach in RANGES:
        values, vectors = np.linalg.eigh(matern(distance / reach))
        squared = np.square(vectors.T @ z)
        for share in SHARES:
            spectrum = share * np.maximum(values, 0.0) + 1.0 - share + JITTER
            sums = np.maximum((squared / spectrum[:, None]).sum(axis=0), 1e-300)
            likelihood = -0.5 * (n * np.log(sums) + np.log(spectrum).sum())
            for c in np.flatnonzero(likelihood > best):
                best[c], chosen[c] = likelihood[c], (float(reach), share)
    return chosen
