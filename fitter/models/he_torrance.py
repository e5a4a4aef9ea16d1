"""Reflection of waves by a Gaussian rough surface: X. He, K. Torrance, F. Sillion and D. Greenberg 1991.

"A comprehensive physical model for light reflection", SIGGRAPH '91, for unpolarised light. The roughness
sigma (rms height) and the correlation length tau are in wavelengths, for each channel its own: a surface of
one sigma in micrometres has sigma/lambda in each. With H = wi + wo not normalised, a = cos/(alpha sin) of a
direction and alpha = 2 sigma/tau (the Beckmann width of the same slopes):

    coherent  a mirror with the share F e^(-g) S_i^2 of the light, g at wo = R(wi): a delta
    diffuse   F S_i S_o / (cos_i cos_o)  (pi tau^2/4) (|H|^2/H_z)^2  sum_m g^m e^(-g)/(m! m) e^(-A/m)
    uniform   kd/pi

    g = (2 pi s H_z)^2,    A = (pi tau)^2 (H_x^2 + H_y^2),    m = 1, 2, ...
    s^2 = sigma^2/(1 + q),    q e^q = (K_i + K_o)^2/(8 pi),    K = tan erfc(a)
    S = (1 - erfc(a)/2)/(1 + Lambda(a)),    Lambda of Beckmann (B. Smith 1967)

F is the conductor's term at c = |H|/2; kappa = 0 makes it a dielectric. The two polarisation factors of the
paper's geometric term are |wi x wo|^2 each for unpolarised light and leave it as (|H|^2/H_z)^2. s is the
paper's effective roughness, the heights that are seen at grazing, with its equation for z_0 solved by
Lambert's W: q = (z_0/sigma)^2. For g -> inf the series becomes e^(-A/g)/g, and the term that of
Cook-Torrance with Beckmann's D and the masking S_i S_o. Reciprocal. Without kd it keeps energy to 2 % down to
cos_i = 0.2 and loses most of it at grazing.

The series is cut at no g. Its terms are a bump about m* = g exp(W(2A/g^2)/2); where that is far from m = 1,
32 terms a stride apart stand for all: for a smooth bump they differ by exp(-2 (pi width/stride)^2) < 1e-20.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.special import erfc

from fitter.models import fresnel, refraction
from fitter.models.base import ReflectanceModel
from fitter.models.diffuse import KD
from fitter.models.lobes import CosineLobe, Delta, Lobe, VisibleNormalLobe
from fitter.models.ndf import GGX, Beckmann
from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter
from fitter.models.roughness import Isotropic
from fitter.spec import ModelSpec

SIGMA = Parameter("sigma", "wavelengths", 0.0, 10.0, 0.1, "rms height of the surface", per_channel=True)
TAU = Parameter(
    "tau", "wavelengths", 0.5, 1e3, 3.0, "correlation length of the heights", search="log", per_channel=True
)

#: Up to a largest term of _FEW the first _FIRST terms are summed one by one; beyond it, _NODES about it.
_FEW, _FIRST = 60.0, 136
_NODES = 32
_BELOW, _ABOVE = 9.0, 10.0


class HeTorrance(ReflectanceModel):
    family: ClassVar[str] = "he_torrance"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        del spec
        return (KD, SIGMA, TAU, *fresnel.PARAMETERS["conductor"])

    def value(self, p: Pair) -> Array:
        above = p.above[..., None]
        p = Pair(*(component[..., None] for component in p.lifted()))
        h = Half.of(p)
        v = self.values
        k_i, seen_i = _grazing(v["sigma"], v["tau"], p.ix, p.iy, p.iz)
        k_o, seen_o = _grazing(v["sigma"], v["tau"], p.ox, p.oy, p.oz)
        s = _effective(v["sigma"], k_i + k_o)
        f = fresnel.conductor(fresnel.facet_cosine(h), v["eta"], v["kappa"])
        turn = 2.0 * math.pi * s * h.z
        sideways = (math.pi * v["tau"]) ** 2 * (h.x * h.x + h.y * h.y)
        geometry = 0.5 * math.sqrt(math.pi) * v["tau"] * h.squared / h.z
        # By its logarithm: the sum alone may be too small for the format where the product is not.
        log_factor = 2.0 * jnp.log(geometry) + jnp.log(seen_i) + jnp.log(seen_o)
        scattered = series(*jnp.broadcast_arrays(turn, sideways, log_factor))
        return jnp.where(above, v["kd"] / math.pi + f * scattered, 0.0)

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        del spec
        sigma, tau = jnp.atleast_1d(values["sigma"]), jnp.atleast_1d(values["tau"])
        # Slopes of the facets, and the diffraction of a patch of the correlation length.
        widths = jnp.minimum(jnp.sqrt(4.0 * sigma * sigma + 0.25 / math.pi**2) / tau, 2.0)
        f = jnp.mean(fresnel.conductor(jnp.ones_like(values["eta"]), values["eta"], values["kappa"]))
        rough = jnp.mean(-jnp.expm1(-((4.0 * math.pi * sigma) ** 2)))
        count = len(widths)
        found: list[tuple[Lobe, Array]] = [
            (VisibleNormalLobe(GGX(Isotropic(width))), f * rough / count) for width in widths
        ]
        return [*found, (CosineLobe(), jnp.mean(values["kd"]) + 0.1 * f * rough)]

    @staticmethod
    def deltas(
        spec: ModelSpec, values: Mapping[str, Array], x: Array, y: Array, z: Array
    ) -> tuple[Delta, ...]:
        del spec
        above = z > 0
        # Grazing light from below must not reach the quotients.
        i, j, c = (jnp.where(above, w, harmless)[..., None] for w, harmless in ((x, 0.0), (y, 0.0), (z, 1.0)))
        k, seen = _grazing(values["sigma"], values["tau"], i, j, c)
        turn = 4.0 * math.pi * _effective(values["sigma"], 2.0 * k) * c
        f = fresnel.conductor(c, values["eta"], values["kappa"])
        weight = jnp.where(above[..., None], f * jnp.exp(-turn * turn) * (seen * c) ** 2, 0.0)
        weight = jnp.broadcast_to(weight, (*z.shape, len(values["kd"])))
        return (Delta(-x, -y, z, weight, jnp.mean(weight, axis=-1)),)


def _grazing(sigma: Array, tau: Array, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """K = tan erfc(a), and S/cos, of a direction above the surface."""
    alpha = 2.0 * sigma / tau
    ndf = Beckmann(Isotropic(alpha))
    s2 = x * x + y * y
    p2 = alpha * alpha * s2
    # Beyond a = 27 even erfc of float64 is 0; there the root and the quotient are kept out of the gradient.
    near = z * z >= 27.0**2 * p2
    a = z / jnp.sqrt(jnp.where(near, 1.0, p2))
    tail = jnp.where(near, 0.0, erfc(jnp.where(near, 27.0, a)))
    tangent = jnp.sqrt(jnp.where(near, 1.0, s2)) / z
    return jnp.where(near, 0.0, tangent * tail), (1.0 - 0.5 * tail) / (z + ndf.lambda_cos(x, y, z))


def _effective(sigma: Array, k: Array) -> Array:
    """Roughness of the heights that are seen: sigma / sqrt(1 + W(k^2/(8 pi)))."""
    info = jnp.finfo(k.dtype)
    k = jnp.maximum(k, float(info.tiny) ** 0.5)
    return sigma / jnp.sqrt(1.0 + lambert_w(2.0 * jnp.log(k) - math.log(8.0 * math.pi)))


def lambert_w(log_x: Array) -> Array:
    """The positive W of W e^W = x, of log x: Newton's steps on W + log W = log x."""
    # Below, W is x and next to nothing; it stays a normal number.
    log_x = jnp.maximum(log_x, 0.9 * math.log(float(jnp.finfo(log_x.dtype).tiny)))
    fixed = jax.lax.stop_gradient(log_x)
    x = jnp.exp(jnp.minimum(fixed, 1.0))
    w = jnp.where(fixed > 1.0, fixed - jnp.log(jnp.maximum(fixed, 1.0)), x / (1.0 + x))
    for _ in range(4):
        w = w * (1.0 + fixed - jnp.log(w)) / (1.0 + w)
    # The last step alone carries the slope W/(1 + W): at the root it is Newton's own.
    return w * (1.0 + log_x - jnp.log(w)) / (1.0 + w)


@jax.custom_jvp
def series(turn: Array, sideways: Array, log_factor: Array) -> Array:
    """e^log_factor times the sum over m = 1, 2, ... of g^m e^(-g) / (m! m) exp(-sideways/m), g = turn^2, for
    arrays of one shape and dtype.

    Relative error 1e-12 + 4 eps |log of it| in float64; in float32 1e-5 + 30 eps |log of it| where it is
    above 1e-30. Measured for g from 1e-12 to 1.5e4 and sideways from 0 to 4e7.
    """
    return _moments(turn, sideways, log_factor)[0]


@series.defjvp
def _series_slopes(
    primals: tuple[Array, Array, Array], tangents: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    turn, _, _ = primals
    total, first, inverse = _moments(*primals)
    # d/d(turn) of a term is 2 (m/turn - turn) times it, d/d(sideways) is -1/m times it.
    safe = jnp.maximum(turn, float(jnp.finfo(turn.dtype).tiny))
    slope = 2.0 * (first / safe - turn * total)
    change = slope * tangents[0] - inverse * tangents[1] + total * tangents[2]
    return total, change


def _moments(turn: Array, sideways: Array, log_factor: Array) -> tuple[Array, Array, Array]:
    """The sums of the terms, of m times and of 1/m times them, all times e^log_factor."""
    tiny = float(jnp.finfo(turn.dtype).tiny)
    log_g, log_a = 2.0 * jnp.log(jnp.maximum(turn, tiny)), jnp.log(jnp.maximum(sideways, tiny))
    g = jnp.maximum(turn * turn, tiny)
    twist = lambert_w(math.log(2.0) + log_a - 2.0 * log_g)
    # Beyond e^60 the sum is 0 in any format.
    peak = jnp.maximum(jnp.exp(jnp.minimum(log_g + 0.5 * twist, 60.0)), 1.0)
    few = _first_terms(g, log_g, sideways, log_factor)
    many = _bump(g, sideways, log_factor, jnp.maximum(peak, _FEW), twist)
    first, second, third = (jnp.where(peak < _FEW, a, b) for a, b in zip(few, many, strict=True))
    return first, second, third


Sums = tuple[Array, Array, Array]


def _first_terms(g: Array, log_g: Array, sideways: Array, log_factor: Array) -> Sums:
    """The first terms one by one, log (m! m) as constants."""
    every = range(1, _FIRST + 1)
    orders = jnp.asarray([float(m) for m in every], g.dtype)
    weights = jnp.asarray([math.lgamma(m + 1) + math.log(m) for m in every], g.dtype)

    def add(sums: Sums, term: tuple[Array, Array]) -> tuple[Sums, None]:
        m, weight = term
        return _added(sums, m, jnp.exp(m * log_g - g - sideways / m - weight + log_factor)), None

    zero = jnp.zeros_like(g)
    return jax.lax.scan(add, (zero, zero, zero), (orders, weights))[0]


def _bump(g: Array, sideways: Array, log_factor: Array, peak: Array, twist: Array) -> Sums:
    """The terms about the largest, one in every stride."""
    width = jnp.sqrt(peak / (1.0 + twist))
    low = jnp.maximum(jnp.floor(peak - _BELOW * width), 1.0)
    stride = jnp.maximum((peak + _ABOVE * width - low) / (_NODES - 1), 1.0)

    def add(k: Array, sums: Sums) -> Sums:
        m = low + k * stride
        # log(g/m), from the difference where that is small; m log g - g - log m! with what cancels combined.
        over = (g - m) / m
        ratio = jnp.where(jnp.abs(over) < 0.5, jnp.log1p(over), jnp.log(g / m))
        # Terms before 9, where Stirling's series is short of digits, are nothing beside those at the peak.
        log = m * (ratio - over) - refraction.stirling(jnp.maximum(m, 9.0)) - 1.5 * jnp.log(m)
        return _added(sums, m, jnp.exp(log - sideways / m + log_factor))

    zero = jnp.zeros_like(g)
    scale = stride / math.sqrt(2.0 * math.pi)
    total, first, inverse = jax.lax.fori_loop(0, _NODES, add, (zero, zero, zero))
    return total * scale, first * scale, inverse * scale


def _added(sums: Sums, m: Array, term: Array) -> Sums:
    total, first, inverse = sums
    return total + term, first + m * term, inverse + term / m
