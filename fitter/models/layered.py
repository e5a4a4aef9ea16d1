"""A rough dielectric coat over any other model (A. Weidlich and A. Wilkie 2007).

"Arbitrarily layered micro-facet surfaces", GRAPHITE 2007, one coat. With h the half vector and n = eta,

    f = F D G / (4 cos_i cos_o) + T f_base(wi', wo') a t,    T = 1 - F,
    a = exp(-tau (1/cos_i' + 1/cos_o')),    t = (1 - G) + T G

wi' and wo' are wi and wo refracted at the facet h itself, where the cosine of both is c = |wi + wo|/2 before
and c' = r/n, r = sqrt(n^2 - 1 + c^2), behind it. Mirrored in h before, they are mirrored in h after:
wi' = c' h + (wi - wo)/(2n) and wo' = c' h - (wi - wo)/(2n). Their heights without a difference are

    cos_i' = p cos_i + m cos_o,  cos_o' = m cos_i + p cos_o,
    p = (r + c)/(2nc),           m = (n^2 - 1)/(2nc (r + c)),

above the surface for n >= 1. T is the transmitted share of power at the cosines c and c'; light on its
way out meets the same (T21 = T). G is Smith's height-correlated term of the coat.

Reciprocal where the base is: c, G and a are symmetric. It does not conserve energy: at grazing the coat
reflects nearly all, yet what the base scatters away from the mirror direction passes a facet that it meets
steeply.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jax import Array

from fitter.errors import SpecError
from fitter.models import composite, fresnel, ndf, refraction
from fitter.models.base import ReflectanceModel
from fitter.models.lobes import Delta, Lobe, VisibleNormalLobe
from fitter.models.masking import facets
from fitter.models.ndf import NDF
from fitter.models.pair import Half, Pair
from fitter.models.parameters import Parameter
from fitter.spec import ModelSpec

ETA = Parameter("eta", "1", 1.0, 2.5, 1.5, "refractive index of the coat")
TAU = Parameter(
    "tau", "1", 0.0, 10.0, 0.0, "optical thickness of the coat, absorption times depth", per_channel=True
)


class Coat(NamedTuple):
    """What the coat does to a pair of directions."""

    top: Array  # its own reflection, 1/sr
    share: Array  # T t, what passes it twice, before absorption
    inside: Pair  # wi' and wo'

    @staticmethod
    def of(normals: NDF, eta: Array, p: Pair) -> Coat:
        h = Half.of(p)
        c = fresnel.facet_cosine(h)
        dx, dy, dz = (0.5 * (i - o) for i, o in ((p.ix, p.ox), (p.iy, p.oy), (p.iz, p.oz)))
        one = jnp.ones_like(eta)
        behind, _ = refraction.refracted_cosine(c, dx * dx + dy * dy + dz * dz, one, eta)
        root = eta * behind
        own = (root + c) / (2.0 * eta * c)
        other = (eta - 1.0) * (eta + 1.0) / (2.0 * eta * c * (root + c))
        # c' h + (wi - wo)/(2n): sideways the sums above cancel at opposed grazing, and upwards their slopes
        # do between directions of like heights; of unlike ones this does.
        along = 0.5 * behind / c
        dx, dy, dz = dx / eta, dy / eta, dz / eta
        like = jnp.abs(p.iz - p.oz) < 0.5 * h.z
        inside = Pair(
            along * h.x + dx, along * h.y + dy, jnp.where(like, along * h.z + dz, own * p.iz + other * p.oz),
            along * h.x - dx, along * h.y - dy, jnp.where(like, along * h.z - dz, other * p.iz + own * p.oz),
        )  # fmt: skip
        # G and 1 - G, each without a difference.
        shadowed = p.oz * normals.lambda_cos(p.ix, p.iy, p.iz) + p.iz * normals.lambda_cos(p.ox, p.oy, p.oz)
        whole = p.iz * p.oz + shadowed
        seen, hidden = p.iz * p.oz / whole, shadowed / whole
        power = refraction.transmittance(c, behind, one, eta)
        top = fresnel.dielectric(c, eta) * facets("smith", p, h, normals)
        # (1 - G) + T G is 1 - F G: the slopes of 1 - G and G cancel, its digits where F G is about 1.
        caught = fresnel.dielectric(c, eta) * seen
        once = jnp.where(caught < 0.5, 1.0 - caught, hidden + power * seen)
        return Coat(top, power * once, inside)


class Layered(composite.Composite):
    family: ClassVar[str] = "layered"

    @staticmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        kind, inner = composite.families(spec)[0]
        if kind.transmits(inner):
            raise SpecError(
                f"a coat can't lie on {inner.name}, which transmits", code="bad-component", parameter="model",
                cause="the model of Weidlich and Wilkie has nothing below its base",
                remedy="give a base that only reflects, as layered(lambert)",
            )  # fmt: skip
        base = composite.parameters(spec)
        linear = [p for p in base if p.linear]
        return (*linear, TAU, ETA, *ndf.parameters(spec), *(p for p in base if not p.linear))

    def value(self, p: Pair) -> Array:
        top, passed, below = self.layers(p.lifted())
        return jnp.where(p.above[..., None], top + passed * below, 0.0)

    def layers(self, p: Pair) -> tuple[Array, Array, Array]:
        """Of a pair above the horizon, (..., C): the coat's reflection, what passes it twice, and the base's
        value below it."""
        base = composite.parts(self)[0]
        wide = Pair(*(component[..., None] for component in p))
        eta, tau = self.values["eta"], self.values["tau"]
        coat = Coat.of(ndf.of(self.spec, self.values), eta, wide)
        below = _per_channel(base, coat.inside, eta.ndim > 0)
        passed = coat.share * jnp.exp(-tau * (1.0 / coat.inside.iz + 1.0 / coat.inside.oz))
        return coat.top, passed, below

    @staticmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        each = ndf.each(spec, values)
        f = fresnel.cosine_average(lambda c: fresnel.dielectric(c, values["eta"]), values["eta"])
        coat: list[tuple[Lobe, Array]] = [
            (VisibleNormalLobe(d.envelope()), jnp.mean(f) / len(each)) for d in each
        ]
        # Twice the mean path straight down: what the base still gets of the light.
        passed = jnp.mean((1.0 - f) ** 2 * jnp.exp(-2.0 * values["tau"]))
        # The base's own directions, drawn in the air: near enough, and their density is exact.
        (kind, inner, own), = composite.kinds(spec, values)  # fmt: skip
        return [*coat, *((lobe, share * passed) for lobe, share in kind.lobes(inner, own))]

    @staticmethod
    def deltas(
        spec: ModelSpec, values: Mapping[str, Array], x: Array, y: Array, z: Array
    ) -> tuple[Delta, ...]:
        """An ideal mirror below is one through the coat: what f is for a base ever closer to a mirror.

        There h = n, and turning wo by d turns wo' against the mirrored wi' by (c'/c) d: the weight of the
        base's mirror takes (c/c')^2 besides T t a.
        """
        above = z > 0
        # Grazing light from below must not reach the roots.
        x, y, z = jnp.where(above, x, 0.0), jnp.where(above, y, 0.0), jnp.where(above, z, 1.0)
        wide = Pair(*(component[..., None] for component in (x, y, z, -x, -y, z)))
        coat = Coat.of(ndf.of(spec, values), values["eta"], wide)
        inside = coat.inside
        passed = jnp.exp(-2.0 * values["tau"] / inside.iz) * coat.share * (wide.iz / inside.iz) ** 2
        found: list[Delta] = []
        (kind, inner, own), = composite.kinds(spec, values)  # fmt: skip
        for delta in kind.deltas(inner, own, inside.ix, inside.iy, inside.iz):
            weight = jnp.where(above[..., None], passed * _diagonal(delta.weight), 0.0)
            found.append(Delta(-x, -y, z, weight, jnp.mean(weight, axis=-1)))
        return tuple(found)


def _per_channel(base: ReflectanceModel, inside: Pair, dispersive: bool) -> Array:
    """The base's value (..., C) at a pair (..., 1), or (..., C) where channels differ in direction."""
    if not dispersive:
        return base.value(Pair(*(component[..., 0] for component in inside)))
    return _diagonal(base.value(inside))


def _diagonal(own: Array) -> Array:
    """(..., C) of (..., 1, C), or of (..., C, C) the channel at its own directions."""
    if own.shape[-2] == 1:
        return own[..., 0, :]
    return jnp.diagonal(own, axis1=-2, axis2=-1)
