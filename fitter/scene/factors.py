"""Enclosures of the factors of a specular term: distribution, visibility, Fresnel, and of what replaces them.

Written so that a variable appears as seldom as it can: masking in 1/cos, once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.scene.boxes import Angles
from fitter.scene.fresnel import facet_cosine, reflectance
from fitter.scene.intervals import Interval, increasing, unit_component
from fitter.spec import ModelSpec

FloatArray = NDArray[np.float64]
Off = frozenset[str]


def facets(
    spec: ModelSpec,
    values: Mapping[str, float],
    off: Off,
    constants: Mapping[str, Any],
    angles: Angles,
    k: int,
) -> tuple[Interval, Interval, Interval]:
    key = spec.name, *values.values()
    hidden = off & {"masking", "hammon", "anisotropy"}
    density, rounder = angles.once((key, "density"), lambda: _density(spec, values, angles))
    visible, ratio = angles.once((key, hidden), lambda: _visibility(spec, values, hidden, angles))
    fresnel = angles.once((key, "fresnel"), lambda: reflectance(spec, values, facet_cosine(angles)))
    if "fresnel" in off:
        ratio = ratio * (Interval.of(float(np.asarray(constants["fresnel"])[k])) / fresnel)
    if "anisotropy" in off:
        ratio = ratio * rounder

    def lobe() -> tuple[Interval, Interval]:
        lit = visible * angles.lz
        lit = Interval(lit.lo, np.minimum(lit.hi, _lit_visibility(spec, values, angles)))
        found = density * fresnel
        return (found * visible).clip(0, np.inf), (found * lit).clip(0, np.inf)

    return *angles.once((key, "lobe"), lobe), ratio.clip(0, np.inf)


def _lit_visibility(spec: ModelSpec, values: Mapping[str, float], angles: Angles) -> FloatArray:
    """An upper bound of n.l V as one expression, which stays finite where both directions graze.

    n.l V <= 1/(4 n.v (1 + Lambda_v)), and n.v (1 + Lambda_v), the mean of max(0, n.v + s t) over slopes t, is
    at least n.v and what it is without n.v: s alpha/(2 sqrt(pi)) of Beckmann, s alpha/2 of GGX. V-grooves:
    G/(4 n.v) <= (n.l + n.v)/(2 (1 + l.v)).
    """
    v = angles.vz
    if spec.masking in (None, "v_groove"):
        with np.errstate(divide="ignore"):
            shaded = ((angles.lz + v) / ((angles.dot + 1.0) * 2.0)).hi
            return np.minimum(shaded, 0.25 / v.lo * (1 + 1e-15))
    least = min(values["alpha_x"], values["alpha_y"]) if spec.anisotropic else values["alpha"]
    across = ((1.0 - v) * (1.0 + v)).clip(0, 1).sqrt().lo * least
    floor = across / (2.0 * math.sqrt(math.pi)) if spec.ndf == "beckmann" else 0.5 * np.maximum(v.lo, across)
    with np.errstate(divide="ignore"):
        return 0.25 / np.maximum(v.lo, floor) * (1 + 1e-14)


def slopes(angles: Angles) -> Interval:
    """tan^2 theta_h = 2 (1 + l.v)/(l_z + v_z)^2 - 1, and by the half vector's own components, which are exact
    to second order where they are small."""

    def found() -> Interval:
        z2 = (angles.lz + angles.vz).squared()
        x, y = _half(angles)
        whole = ((angles.dot + 1.0) * 2.0 / z2 - 1.0).clip(0, np.inf)
        return ((x.squared() + y.squared()) / z2).meet(whole)

    return angles.once("slopes", found)


def _density(spec: ModelSpec, values: Mapping[str, float], angles: Angles) -> tuple[Interval, Interval]:
    """D, and of two roughnesses that of the mean one over it."""
    tan2 = slopes(angles)
    area = values["alpha_x"] * values["alpha_y"] if spec.anisotropic else values["alpha"] ** 2
    if spec.ndf == "beckmann":
        return _gaussian(tan2, area), Interval.of(np.ones(tan2.lo.shape))
    cos2 = (tan2 + 1.0).reciprocal()
    stretch = Interval.of(1.0 / area)
    if spec.anisotropic:
        stretch = _stretch(values, angles)
    # 1/(pi area (cos^2 + stretch sin^2)^2), and the ratio as 1 + (difference of stretches) times one term.
    density = _mixed(cos2, stretch).squared().reciprocal() * (1.0 / (math.pi * area))
    ratio = (stretch - 1.0 / area) * (tan2.reciprocal() + 1.0 / area).reciprocal() + 1.0
    return density, ratio.clip(0, np.inf).squared()


def _gaussian(tan2: Interval, area: float) -> Interval:
    """exp(-t/alpha^2) (1 + t)^2/(pi alpha^2) of t = tan^2: rises up to t = 2 alpha^2 - 1, then falls to 0."""

    def at(t: FloatArray) -> FloatArray:
        t = np.minimum(t, 1e4 * (1 + area))
        return np.exp(-t / area) * (1.0 + t) ** 2 / (math.pi * area)

    ends = at(tan2.lo), at(tan2.hi)
    top = at(np.clip(2.0 * area - 1.0, tan2.lo, tan2.hi))
    # An exponent of up to 700 loses as many units; from 1e4 on both are less than the smallest number.
    return increasing(np.minimum(*ends), np.maximum(np.maximum(*ends), top), 10_000)


def _half(angles: Angles) -> tuple[Interval, Interval]:
    return angles.l[0] + angles.v[0], angles.l[1] + angles.v[1]


def _stretch(values: Mapping[str, float], angles: Angles) -> Interval:
    """1/alpha^2 in the azimuth of the half vector."""
    along, across = (1.0 / values[name] ** 2 for name in ("alpha_x", "alpha_y"))
    return _mean(values, along, across, angles, _half(angles))


def turned(
    psi: float, angles: Angles, w: tuple[Interval, Interval]
) -> tuple[Interval, Interval]:  # fmt: skip
    """Components w along the tangents in the frame of roughness: the sample's axes, turned by psi."""
    c, s = math.cos(psi), math.sin(psi)
    p, q = angles.axis[1] * c + angles.axis[0] * s, angles.axis[1] * s - angles.axis[0] * c
    return w[0] * p + w[1] * q, w[1] * p - w[0] * q


def _mean(
    values: Mapping[str, float], along: float, across: float, angles: Angles, w: tuple[Interval, Interval]
) -> Interval:  # fmt: skip
    """along cos^2 + across sin^2 of the azimuth of w in the frame of roughness, which appears once."""
    x, y = turned(values["psi"], angles, w)
    found = unit_component(x, y.squared()).squared() * (along - across) + across
    return found.clip(min(along, across) * (1 - 1e-15), max(along, across) * (1 + 1e-15))


def _mixed(w: Interval, a: Interval) -> Interval:
    """w + a (1 - w) of w in [0, 1], linear in both."""
    w = w.clip(0, 1)
    low = np.minimum(w.lo + a.lo * (1 - w.lo), w.hi + a.lo * (1 - w.hi))
    high = np.maximum(w.lo + a.hi * (1 - w.lo), w.hi + a.hi * (1 - w.hi))
    return increasing(low, high)


def _root(alpha2: float | Interval, c: Interval) -> Interval:
    """sqrt(alpha^2 + (1 - alpha^2) c^2) over c in [0, 1]."""
    a = alpha2 if isinstance(alpha2, Interval) else Interval.of(alpha2)
    return _mixed(c.squared(), a).sqrt()


def _visibility(
    spec: ModelSpec, values: Mapping[str, float], off: Off, angles: Angles
) -> tuple[Interval, Interval]:
    """V = G/(4 n.l n.v), and V' / V of what takes its place."""
    l, v = angles.lz, angles.vz
    one = Interval.of(np.ones(l.lo.shape))
    if spec.masking in (None, "v_groove"):
        both = angles.dot + 1.0
        g = ((l + v) * l.minimum(v) * 2.0 / both).clip(0, 1)
        # G/(4 l v) is 1/(4 l v) or (l + v)/(2 (1 + l.v) max); the sum over the larger is 1 to 2.
        lit = (l * v).reciprocal() * 0.25
        shaded = ((l + v) / l.maximum(v)).clip(1, 2) / (both * 2.0)
        value = lit.minimum(shaded)
        return value.clip(0, np.inf), (g.reciprocal() if "masking" in off else one)
    if spec.ndf == "beckmann":
        a, b = _beckmann(values["alpha"], l), _beckmann(values["alpha"], v)
        g = (a + b + 1.0).reciprocal() if spec.masking == "smith" else ((a + 1.0) * (b + 1.0)).reciprocal()
        value = g * 0.25 / (l * v)
        return value.clip(0, np.inf), (g.reciprocal() if "masking" in off else one)
    if spec.anisotropic:
        return _anisotropic(values, off, angles)
    alpha = values["alpha"]
    p, q = _over_cosine(alpha, l), _over_cosine(alpha, v)
    if spec.masking == "smith":
        value = 0.5 / (v * _root(alpha**2, l) + l * _root(alpha**2, v))
        inverse = (p + q) * 0.5
    else:
        value = 1.0 / ((l + _root(alpha**2, l)) * (v + _root(alpha**2, v)))
        inverse = (p + 1.0) * (q + 1.0) * 0.25
    if "masking" in off:
        return value, inverse
    if "hammon" in off:
        plain = (l.reciprocal() + v.reciprocal()) * alpha + 2.0 * (1.0 - alpha)
        ratio = 1.0 - (_saved(alpha, l) + _saved(alpha, v)) / plain
        # Each sum's terms: h/g lies between sqrt((1 + alpha)/2) and 1 (see the module).
        least = math.sqrt((1.0 + alpha) / 2.0) * (1 - 1e-15)
        return value, ratio.clip(min(least, 1.0), 1.0)
    return value, one


def unshadowed(spec: ModelSpec, values: Mapping[str, float], angles: Angles) -> Interval:
    """G, the share of facets that are both lit and seen."""
    return _visibility(spec, values, frozenset({"masking"}), angles)[1].reciprocal().clip(0, 1)


def _over_cosine(alpha: float, c: Interval) -> Interval:
    """sqrt(alpha^2/c^2 + 1 - alpha^2) for alpha up to 2: decreasing in c."""

    def at(x: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            return np.hypot(1.0, alpha * np.sqrt(np.maximum((1 - x) * (1 + x), 0.0)) / x)

    return increasing(at(c.hi), at(c.lo))


def _saved(alpha: float, c: Interval) -> Interval:
    """alpha/c + 1 - alpha, what Hammon's form has, less sqrt(alpha^2/c^2 + 1 - alpha^2), alpha up to 1,
    without a difference of what is large at grazing: decreasing in c, from 1 - alpha to 0."""

    def at(x: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            y = alpha / x
            return (1.0 - alpha) * (1.0 - (1.0 + alpha) / (y + np.hypot(y, math.sqrt(1.0 - alpha * alpha))))

    low, high = at(c.hi), at(c.lo)
    return Interval(low - 1e-15, high + 1e-15).clip(0.0, 1.0 - alpha)


def _beckmann(alpha: float, c: Interval) -> Interval:
    """Smith's Lambda = exp(-a^2) (1/(a sqrt(pi)) - erfcx(a))/2 of a = cot/alpha, decreasing in c. The
    difference loses 2 a^2 units of rounding, and from a = 6 on Lambda is below 1e-17: widened by much
    more."""
    from scipy.special import erfcx

    def at(x: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            a = x / (alpha * np.sqrt(np.maximum((1 - x) * (1 + x), 0.0)))
            found = 0.5 * np.exp(-a * a) * (1.0 / (a * math.sqrt(math.pi)) - erfcx(a))
        return np.where(x > 0, np.where(a < 6.0, np.maximum(found, 0.0), 0.0), np.inf)

    low, high = at(c.hi), at(c.lo)
    return Interval(low * (1 - 1e-9), high * (1 + 1e-9) + 1e-14)


def _anisotropic(values: Mapping[str, float], off: Off, angles: Angles) -> tuple[Interval, Interval]:
    """Height-correlated Smith of two roughnesses, each direction's as one of its azimuth."""
    squares = values["alpha_x"] ** 2, values["alpha_y"] ** 2
    l, v = angles.lz, angles.vz
    mean = values["alpha_x"] * values["alpha_y"]
    a, b = (_mean(values, *squares, angles, w) for w in (angles.l, angles.v))
    exact = v * _root(a, l) + l * _root(b, v)
    value = 0.5 / exact
    # tan^2 of each direction.
    p, q = ((c.squared().reciprocal() - 1.0).clip(0, np.inf) for c in (l, v))
    if "masking" in off:
        return value, ((a * p + 1.0).sqrt() + (b * q + 1.0).sqrt()) * 0.5
    if "anisotropy" in off:
        # Sums of two terms each: the quotient lies between those of the terms, sqrt(1 + (a - mean) x).
        one, two = (
            ((one - mean) * (t.reciprocal() + mean).reciprocal() + 1.0).sqrt() for one, t in ((a, p), (b, q))
        )
        between = Interval(np.minimum(one.lo, two.lo), np.maximum(one.hi, two.hi))
        return value, (exact / (v * _root(mean, l) + l * _root(mean, v))).meet(between)
    return value, Interval.of(np.ones(l.lo.shape))


def ward(spec: ModelSpec, values: Mapping[str, float], off: Off, angles: Angles) -> tuple[Interval, Interval]:
    l, v = angles.lz, angles.vz
    tan2 = slopes(angles)
    area = values["alpha_x"] * values["alpha_y"] if spec.anisotropic else values["alpha"] ** 2
    exponent = tan2 / area
    ratio = Interval.of(np.ones(l.lo.shape))
    if spec.anisotropic:
        stretch = _stretch(values, angles)
        if "anisotropy" in off:
            ratio = ((stretch - 1.0 / area) * tan2).exp()
        exponent = stretch * tan2
    if spec.variant == "bounded":
        level = (angles.dot + 1.0) * (2.0 / (math.pi * area)) / (l + v).squared().squared()
    elif spec.variant == "duer":
        level = (1.0 / (4 * math.pi * area)) / (l * v)
    else:
        level = (1.0 / (4 * math.pi * area)) / (l * v).sqrt()
    return ((-exponent).exp() * level).clip(0, np.inf), ratio
