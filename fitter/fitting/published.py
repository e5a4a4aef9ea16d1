"""Errors of a fit as publications define them, under their own names, to be compared with their figures.

They are computed of a fit, whatever metric it minimised:

    ngan_l2   sqrt(sum w ((f - y) cos_i)^2 / sum w), theta_i and theta_o below 80 deg
              A. Ngan, F. Durand, W. Matusik, "Experimental analysis of BRDF models", EGSR 2005
    low_e1    sum w ((f - y) cos_i)^2 / sum w
    low_e2    sum w (ln(1 + f cos_i) - ln(1 + y cos_i))^2 / sum w
              J. Low, J. Kronander, A. Ynnerman, J. Unger, "BRDF models for accurate and efficient rendering
              of glossy surfaces", ACM Transactions on Graphics 31(1), 2012

w is the solid angle that a sample stands for (:mod:`fitter.fitting.measures`), 1 where a table does not tell
it; the sums run over channels too, and the last two are divided by sum w, so that tables can be compared.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.fitting.measures import measures
from fitter.models.base import ReflectanceModel
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Ngan et al. leave out what is nearer to grazing.
GRAZING = math.radians(80.0)
#: Pairs that the model is evaluated at at once.
CHUNK = 65_536


class Published(NamedTuple):
    """The errors, 1/sr for the first and its square for the second; NaN where no sample is left.
    ``solid_angles`` : whether samples are weighted by them. ``left_out`` : values whose logarithm does not
    exist, y cos_i <= -1."""

    ngan_l2: float
    low_e1: float
    low_e2: float
    solid_angles: bool
    left_out: int


def published(model: ReflectanceModel, table: Table) -> Published:
    """The errors of a model over the usable samples of a table whose channels it has, by name.

    Raises SpecError where the table lacks one of the model's channels.
    """
    names = [channel.name for channel in table.channels]
    missing = sorted(set(model.channels) - set(names))
    if missing:
        raise SpecError(
            f"the table has no channel {missing[0]!r}, which the model has", code="unknown-channel",
            parameter="channels", remedy=f"its channels are {', '.join(names)}",
        )  # fmt: skip
    columns = [names.index(name) for name in model.channels]
    index = np.flatnonzero(table.mask)
    try:
        weight, told = measures(table, table.mask)[index], True
    except SpecError:
        # Neither a grid nor scans: every sample counts alike, and the result says so.
        weight, told = np.ones(len(index)), False
    sums, left_out = np.zeros(6), 0
    for start in range(0, len(index), CHUNK):
        rows = index[start : start + CHUNK]
        wi, wo = table.directions(rows)
        y, f = table.value[rows][:, columns], np.asarray(model.evaluate(wi, wo))
        cos_i, w = wi[:, 2:], weight[start : start + CHUNK, None]
        plain = w * np.square((f - y) * cos_i)
        steep = (np.minimum(wi[:, 2], wo[:, 2]) > math.cos(GRAZING))[:, None]
        defined = y * cos_i > -1.0
        logs = np.log1p(np.maximum(f * cos_i, 0.0)) - np.log1p(np.where(defined, y * cos_i, 0.0))
        full = np.broadcast_to(w, y.shape)
        left_out += int((~defined).sum())
        sums += [
            (plain * steep).sum(), (full * steep).sum(), plain.sum(), full.sum(),
            (w * np.square(logs) * defined).sum(), (full * defined).sum(),
        ]  # fmt: skip
    shares = [above / below if below > 0 else math.nan for above, below in sums.reshape(3, 2)]
    return Published(math.sqrt(shares[0]), float(shares[1]), float(shares[2]), told, left_out)
