"""Masking and shadowing G of a pair.

V-groove: Torrance and Sparrow 1967. Smith 1967 in the forms of Walter et al. 2007 (exact) and Heitz 2014
(height-correlated); for Blinn's and the Gaussian distribution the Lambda that the projected-area identity
gives: Lambda cos = Int D max(0, -w.m) dm. Schlick-GGX: Schlick 1994 with k = alpha/2 (Karis 2013).
Rational: Walter et al. 2007, equation 27.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache

from mpmath import mp, mpf
from mpmath.calculus.quadrature import GaussLegendre

from tests.evidence.reference.geometry import Pair, turned
from tests.evidence.reference.ndf import gaussian_weight, widths

Lambda = Callable[[Mapping[str, mpf], mpf, mpf, mpf], mpf]


def _inverse_a2(values: Mapping[str, mpf], x: mpf, y: mpf, z: mpf) -> mpf:
    """(alpha tan theta)^2 of a direction."""
    ax, ay, psi = widths(values)
    x, y = turned(x, y, psi)
    return ((ax * x) ** 2 + (ay * y) ** 2) / z**2


def lambda_ggx(values: Mapping[str, mpf], x: mpf, y: mpf, z: mpf) -> mpf:
    return (mp.sqrt(1 + _inverse_a2(values, x, y, z)) - 1) / 2


def lambda_beckmann(values: Mapping[str, mpf], x: mpf, y: mpf, z: mpf) -> mpf:
    inverse = _inverse_a2(values, x, y, z)
    if not inverse:
        return mpf(0)
    a = 1 / mp.sqrt(inverse)
    return mp.exp(-a * a) / (2 * a * mp.sqrt(mp.pi)) - mp.erfc(a) / 2


def lambda_blinn(values: Mapping[str, mpf], x: mpf, y: mpf, z: mpf) -> mpf:
    """Slopes of Blinn's D have the marginal (n+2)/(2 pi) B(1/2, (n+3)/2) (1 + q^2)^(-(n+3)/2); its first
    moment beyond cot(theta) is elementary, its tail an incomplete beta function."""
    tan2, n = (x * x + y * y) / z**2, values["n"]
    if not tan2:
        return mpf(0)
    cot2 = 1 / tan2
    if (n + 1) / 2 * mp.log1p(cot2) > 3 * mp.dps:
        return mpf(0)
    constant = (n + 2) / (2 * mp.pi) * mp.beta(mpf(1) / 2, (n + 3) / 2)
    moment = (1 + cot2) ** (-(n + 1) / 2) / (n + 1)
    return constant * (moment / mp.sqrt(cot2) - _student_tail((n + 3) / 2, cot2))


def _student_tail(a: mpf, m2: mpf) -> mpf:
    """Int_m^oo (1 + q^2)^-a dq by the hypergeometric series that converges, all terms of one sign."""
    small = mpf(10) ** (-mp.dps)
    term, total, k = mpf(1), mpf(0), 0
    if m2 < 1:
        # Int_0^m = m (1 + m^2)^-a 2F1(a, 1; 3/2; m^2/(1 + m^2)).
        y = m2 / (1 + m2)
        while term > small * total or k < a * y:
            total += term
            term *= (a + k) / (k + mpf(3) / 2) * y
            k += 1
        below = mp.sqrt(m2) * (1 + m2) ** -a * total
        return mp.beta(mpf(1) / 2, a - mpf(1) / 2) / 2 - below
    x, p = 1 / (1 + m2), a - mpf(1) / 2
    while term > small * total:
        total += term / (2 * (p + k))
        term *= (k + mpf(1) / 2) / (k + 1) * x
        k += 1
    return x**p * total


def lambda_gaussian(values: Mapping[str, mpf], x: mpf, y: mpf, z: mpf) -> mpf:
    """(1/cos theta) Int D max(0, -w.m) dm, the azimuth of m in closed form, its angle t by quadrature.

    m at t > d = pi/2 - theta is turned away over azimuths of half width acos(u), u = tan(d)/tan(t).
    """
    across, s = mp.sqrt(x * x + y * y), values["s"]
    if not across:
        return mpf(0)
    tan_d, d = z / across, mp.atan2(z, across)

    def away(t: mpf) -> mpf:
        u = min(mpf(1), tan_d / mp.tan(t))
        facing = mp.sin(t) * mp.sqrt((1 - u) * (1 + u)) - tan_d * mp.cos(t) * mp.acos(u)
        return 2 * mp.exp(-((t / s) ** 2)) * facing * mp.sin(t)

    def stretched(v: mpf) -> mpf:
        # tan t = tan d exp(v^2): analytic where the azimuths' range opens, and at every scale of d.
        tan_t = tan_d * mp.exp(v * v)
        return away(mp.atan(tan_t)) * 2 * v * tan_t / (1 + tan_t**2)

    # Beyond 9 widths the Gaussian is below 1e-35; between, pieces that grow with t.
    last = min(mp.pi / 2, 9 * s)
    if last <= d:
        return mpf(0)
    near = min(last, 2 * d)
    total = (
        _rule(stretched, mpf(0), mp.sqrt(mp.log(mp.tan(near) / tan_d)))
        if near < 1
        else _rule(lambda v: away(d + (near - d) * v * v) * 2 * (near - d) * v, mpf(0), mpf(1))
    )
    while near < last:
        far = min(last, 3 * near, near + s)
        total += _rule(away, near, far)
        near = far
    return total / (tan_d * gaussian_weight(s))


def _rule(f: Callable[[mpf], mpf], low: mpf, high: mpf) -> mpf:
    """Gauss-Legendre of fixed nodes: a smooth function of the limits, as differences need."""
    half, middle = (high - low) / 2, (high + low) / 2
    return half * mp.fsum(w * f(middle + half * v) for v, w in _nodes(mp.prec))


@cache
def _nodes(precision: int) -> list[tuple[mpf, mpf]]:
    return GaussLegendre(mp).get_nodes(-1, 1, 4, precision)


LAMBDAS: dict[str, Lambda] = {
    "ggx": lambda_ggx, "beckmann": lambda_beckmann, "blinn": lambda_blinn, "gaussian": lambda_gaussian,
}  # fmt: skip


def v_groove(p: Pair) -> mpf:
    return min(mpf(1), 4 * p.half.z * min(p.iz, p.oz) / p.half.squared)


def smith(ndf: str, values: Mapping[str, mpf], p: Pair) -> mpf:
    """Height-correlated."""
    found = LAMBDAS[ndf]
    return 1 / (1 + found(values, p.ix, p.iy, p.iz) + found(values, p.ox, p.oy, p.oz))


def smith_separable(ndf: str, values: Mapping[str, mpf], p: Pair) -> mpf:
    found = LAMBDAS[ndf]
    return 1 / ((1 + found(values, p.ix, p.iy, p.iz)) * (1 + found(values, p.ox, p.oy, p.oz)))


def schlick_ggx(values: Mapping[str, mpf], p: Pair) -> mpf:
    k = values["alpha"] / 2
    return p.iz / (p.iz * (1 - k) + k) * p.oz / (p.oz * (1 - k) + k)


def rational(values: Mapping[str, mpf], p: Pair) -> mpf:
    def one(x: mpf, y: mpf, z: mpf) -> mpf:
        inverse = _inverse_a2(values, x, y, z)
        if inverse * mpf("2.56") <= 1:
            return mpf(1)
        a = 1 / mp.sqrt(inverse)
        return (mpf("3.535") * a + mpf("2.181") * a * a) / (1 + mpf("2.276") * a + mpf("2.577") * a * a)

    return one(p.ix, p.iy, p.iz) * one(p.ox, p.oy, p.oz)


def masking(kind: str, ndf: str, values: Mapping[str, mpf], p: Pair) -> mpf:
    """G of the named form."""
    if kind == "v_groove":
        return v_groove(p)
    if kind == "schlick_ggx":
        return schlick_ggx(values, p)
    if kind == "rational":
        return rational(values, p)
    return {"smith": smith, "smith_separable": smith_separable}[kind](ndf, values, p)
