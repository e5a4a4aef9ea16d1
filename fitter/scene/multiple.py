"""Enclosure of what Kulla and Conty add: F_ms (1 - E(n.l)) (1 - E(n.v)) / (pi (1 - E_avg)), over ks.

1 - E is a Chebyshev series q of x, a monotone function of the cosine, over a scale that grows with it
(:mod:`fitter.models.scattering_loss`). It is not monotone itself: [0, 1] is cut into cells of x, on each of
which q is within h^2/8 max |q''| of the line between its values at the ends, |T_k''| <= k^2 (k^2 - 1)/3; a
box takes the extremes of the cells that it touches.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter.models import scattering_loss
from fitter.models.kulla_conty import colour_of
from fitter.scene.boxes import Angles
from fitter.scene.intervals import Interval, increasing
from fitter.scene.runs import Runs
from fitter.spec import ModelSpec

FloatArray = NDArray[np.float64]
_CELLS = 1 << 14
#: More than the rounding of a series beside its coefficients, of coordinates, and of a few products.
_ROUNDED = 1e-11


def scattered(spec: ModelSpec, values: Mapping[str, float], angles: Angles) -> Interval:
    lost = _loss(spec.ndf or "ggx", values["alpha"])
    own = {name: jnp.asarray(x) for name, x in values.items()}
    level = float(colour_of(spec, own, jnp.asarray(lost.average))) / (math.pi * lost.average)
    return lost.over(angles.lz) * lost.over(angles.vz) * increasing(np.asarray(level), np.asarray(level))


class _Loss:
    """1 - E of one distribution and roughness over boxes of cosines."""

    def __init__(self, kind: str, alpha: float) -> None:
        found = scattering_loss.loss(kind, jnp.asarray(alpha))
        self.alpha, self.average = alpha, float(found.average)
        self.top = float(scattering_loss.top_of(kind, found.alpha))
        c = np.asarray(found.coefficients, np.float64)
        k2 = np.arange(len(c)) ** 2.0
        x = np.linspace(0.0, 1.0, _CELLS + 1)
        bend = float(np.sum(np.abs(c) * k2 * np.maximum(k2 - 1, 0.0))) / 3
        wide = bend * (2 / _CELLS) ** 2 / 8 + _ROUNDED * float(np.sum(np.abs(c)))
        q = np.polynomial.chebyshev.chebval(2 * x - 1, c)
        cosine, _ = scattering_loss.cosine_at(kind, found.alpha, jnp.asarray(x))
        scale = np.asarray(scattering_loss.scale_of(kind, cosine / alpha))
        low = np.maximum(np.minimum(q[1:], q[:-1]) - wide, 0.0) / scale[1:] * (1 - _ROUNDED)
        high = np.maximum(np.maximum(q[1:], q[:-1]) + wide, 0.0) / scale[:-1] * (1 + _ROUNDED)
        # Beyond Beckmann's top nothing is lost; GGX has none below 1.
        beyond = 0.0 if kind == "beckmann" else low[-1]
        self._cells = Runs(np.append(low, beyond), np.append(high, beyond))

    def over(self, c: Interval) -> Interval:
        return self._cells.over(self._cell(c.lo, -_ROUNDED), self._cell(c.hi, _ROUNDED))

    def _cell(self, c: FloatArray, by: float) -> NDArray[np.intp]:
        x = np.sqrt(np.arcsinh(c / self.alpha) / np.arcsinh(self.top / self.alpha))
        return np.clip(np.floor((x + by) * _CELLS), 0, _CELLS).astype(np.intp)


_loss = lru_cache(maxsize=16)(_Loss)
