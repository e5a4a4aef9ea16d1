"""Enclosures of Fresnel terms."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from fitter.scene.boxes import Angles
from fitter.scene.intervals import Interval
from fitter.scene.runs import Runs
from fitter.spec import ModelSpec

#: Cells of the tables of exact terms.
_CELLS = 1 << 13


def facet_cosine(angles: Angles) -> Interval:
    """cos theta_d = sqrt((1 + l.v)/2)."""
    return ((angles.dot + 1.0) * 0.5).sqrt().clip(0, 1)


def reflectance(spec: ModelSpec, values: Mapping[str, float], c: Interval) -> Interval:
    """The Fresnel term over an interval of cosines."""
    if spec.fresnel == "schlick":
        f0 = values["f0"]
        return ((1.0 - c).clip(0, 1).power5() * (1.0 - f0) + f0).clip(0.0, max(1.0, f0))
    if spec.fresnel in (None, "none"):
        return Interval.of(np.ones(c.lo.shape))
    exact = values["eta"], values["kappa"] if spec.fresnel == "conductor" else None
    first, last = (np.clip((x * _CELLS).astype(np.intp), 0, _CELLS - 1) for x in (c.lo, c.hi))
    wide = _table(*exact).over(first, last)
    narrow = np.flatnonzero(first == last)
    if not len(narrow):
        return wide
    near = _exact(*exact, Interval(c.lo[narrow], c.hi[narrow])).meet(
        Interval(wide.lo[narrow], wide.hi[narrow])
    )
    wide.lo[narrow], wide.hi[narrow] = near.lo, near.hi
    return wide


@lru_cache(maxsize=64)
def _table(eta: float, kappa: float | None) -> Runs:
    """Of an exact Fresnel term over cells of cosines: it need not be monotone, and each cosine appears in it
    often."""
    edges = np.arange(_CELLS + 1) / _CELLS
    one = _exact(eta, kappa, Interval(edges[:-1], edges[1:]))
    return Runs(one.lo, one.hi)


def _exact(eta: float, kappa: float | None, c: Interval) -> Interval:
    """Fresnel's equations for a dielectric, or (with ``kappa``) a conductor."""
    c2 = c.squared()
    if kappa is None:
        n2 = Interval.of(eta).squared()
        g = (n2 - 1.0 + c2).clip(0, np.inf).sqrt()
        s = ((n2 - 1.0) / (c + g).squared()).squared()
        p = ((n2 - 1.0) * (c2 * (n2 + 1.0) - 1.0) / (n2 * c + g).squared()).squared()
        return ((s + p) * 0.5).clip(0, 1)
    n, k = Interval.of(eta), Interval.of(kappa)
    s2 = (1.0 - c2).clip(0, 1)
    q = n.squared() - k.squared() - s2
    m = (q.squared() + (2.0 * n * k).squared()).sqrt()
    a = ((m + q) * 0.5).clip(0, np.inf).sqrt()
    # |g - c|^2/|g + c|^2 and |g c - s^2|^2/|g c + s^2|^2 of the root g, as 1 - 2x/(1 + x): one quotient.
    x = 2.0 * a * c / (m + c2)
    y = 2.0 * a * c * s2 / (m * c2 + s2.squared())
    s = ((1.0 - x) / (1.0 + x)).clip(0, 1)
    p = ((1.0 - y) / (1.0 + y)).clip(0, 1)
    return (s * (p + 1.0) * 0.5).clip(0, 1)
