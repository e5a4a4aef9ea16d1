"""Lafortune, Foo, Torrance and Greenberg 1997, the coefficients as angles on the unit sphere."""

from __future__ import annotations

from collections.abc import Mapping

from mpmath import mp, mpf

from fitter.spec import ModelSpec
from tests.evidence.reference.geometry import Pair


def lafortune(spec: ModelSpec, values: Mapping[str, mpf], p: Pair) -> mpf:
    psi = values.get("psi", mpf(0))
    suffixes = [f"_{k + 1}" for k in range(spec.lobes)] if spec.lobes > 1 else [""]
    return mp.fsum(_lobe(values, suffix, p.turned(psi)) for suffix in suffixes)


def _lobe(values: Mapping[str, mpf], suffix: str, p: Pair) -> mpf:
    gamma, n, ks = (values[f"{name}{suffix}"] for name in ("gamma", "n", "ks"))
    cx = cy = -mp.sin(gamma)
    if f"delta{suffix}" in values:
        delta = values[f"delta{suffix}"]
        cx, cy = (-mp.sqrt(2) * mp.sin(gamma) * part for part in (mp.cos(delta), mp.sin(delta)))
    cz = mp.cos(gamma)
    base = cx * p.ix * p.ox + cy * p.iy * p.oy + cz * p.iz * p.oz
    return ks * (n + 2) / (2 * mp.pi) * cut_power(base / max(abs(cx), abs(cy), abs(cz)), n)


def cut_power(base: mpf, n: mpf) -> mpf:
    """max(0, base)^n, and 0 below the cut for n = 0 too: the limit of n -> 0."""
    return base**n if base > 0 else mpf(0)
