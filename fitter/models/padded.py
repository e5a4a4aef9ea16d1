"""Evaluation of many pairs at once, padded so that few programs are compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fitter.models.base import ReflectanceModel

FloatArray = NDArray[np.float64]


def evaluated(model: ReflectanceModel, wi: FloatArray, wo: FloatArray) -> FloatArray:
    """(n, C) values of ``model`` in 1/sr; padded to one of few lengths, so that few programs are compiled."""
    n = len(wi)
    padding = ((0, max(1024, 1 << (n - 1).bit_length()) - n), (0, 0))
    return np.asarray(model.evaluate(np.pad(wi, padding, mode="edge"), np.pad(wo, padding, mode="edge")))[:n]
