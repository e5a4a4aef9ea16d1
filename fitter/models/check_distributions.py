"""Are the distributions of microfacets normalised, and do the masking forms conserve projected area?

Int G1(o, m) D(m) max(0, o.m) dm = cos(theta_o) says that what is seen of the facets from o covers as much as
the surface does (E. Heitz 2014, eq. 14). Smith's forms and V-grooves obey it; the approximations of Smith's
don't, and it is shown by how much.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator

import jax
import jax.numpy as jnp
from jax import Array

from fitter.models import ndf, slopes
from fitter.models.masking import MASKINGS
from fitter.models.pair import Half, Pair
from fitter.spec import OPTIONS, ModelSpec

ANGLES_DEG = (1.0, 45.0, 75.0, 89.0)
#: Values of each width at which a distribution is looked at.
WIDTHS = {"alpha": (0.01, 0.1, 0.5, 1.0), "n": (0.0, 20.0, 1e4), "s": (0.02, 0.2, 1.0)}
#: How far a distribution's integral may be from 1, and the visible area from the cosine, over it.
NORMALISED, IDENTITY = 1e-6, 2e-4
CLAIM_IT = ("smith", "smith_separable", "v_groove")
#: Gauss nodes in the facet's polar angle and in a quarter of its azimuth.
POLAR, QUARTER = 48, 24


def distributions() -> Iterator[tuple[str, float, float | None, str]]:
    """Figures (name, value, bound or None where it only informs, where it was worst)."""
    choices = OPTIONS["torrance_sparrow"].choices
    for kind in choices["ndf"]:
        name = ndf.parameters(ModelSpec(family="torrance_sparrow", ndf=kind))[0].name
        whole = [(abs(_area(kind, None, width, 0.0) - 1.0), f"{name} {width:g}") for width in WIDTHS[name]]
        worst, where = max(whole)
        yield f"{kind}: integral from 1", worst, NORMALISED, where
        for masking in choices["masking"]:
            if not _goes(kind, masking):
                continue
            seen = [
                (abs(_area(kind, masking, width, angle) / math.cos(math.radians(angle)) - 1.0), width, angle)
                for width in WIDTHS[name]
                for angle in ANGLES_DEG
            ]
            worst, width, angle = max(seen)
            bound = IDENTITY if masking in CLAIM_IT else None
            yield f"{kind}, {masking}: visible area", worst, bound, f"{name} {width:g}, {angle:g} deg"


def _goes(kind: str, masking: str) -> bool:
    """Whether a masking form is defined for a distribution."""
    try:
        ModelSpec(family="torrance_sparrow", ndf=kind, masking=masking)
    except ValueError:
        return False
    return True


def _area(kind: str, masking: str | None, width: float, degrees: float) -> float:
    """The area of the facets seen from an angle, of a unit of surface; without masking, those seen from
    above: 1."""
    return float(_integral(kind, masking, jnp.asarray(width), jnp.asarray(math.radians(degrees))))


@functools.partial(jax.jit, static_argnums=(0, 1))
def _integral(kind: str, masking: str | None, width: Array, angle: Array) -> Array:
    spec = ModelSpec(family="torrance_sparrow", ndf=kind)
    normals = ndf.of(spec, {ndf.parameters(spec)[0].name: width})
    s, c = jnp.sin(angle), jnp.cos(angle)
    x, w = slopes.clustered(QUARTER, width)
    phi = 0.5 * math.pi * jnp.concatenate([x, 1.0 + x])[:, None]
    w_phi = math.pi * jnp.concatenate([w, w])[:, None]
    # Facets that look away from o are not seen, so that the polar angle ends there.
    away = -s * jnp.cos(phi)
    end = jnp.where(away > 0, jnp.arctan2(c, away), 0.5 * math.pi)
    scale = jnp.sqrt(2.0 / (width + 2.0)) if kind == "blinn" else width
    x, w = slopes.gauss(POLAR, width)
    theta, w_theta = slopes.graded(jnp.zeros_like(end), end / scale, x, w)
    theta, w_theta = scale * theta, scale * w_theta
    m = (jnp.sin(theta) * jnp.cos(phi), jnp.sin(theta) * jnp.sin(phi), jnp.cos(theta))
    seen = s * m[0] + c * m[2]
    # The half vector that o and its mirror image in m have: H = 2 (o.m) m.
    h = Half(2.0 * seen * m[0], 2.0 * seen * m[1], 2.0 * seen * m[2], 4.0 * seen * seen)
    total = normals.density(h) * seen * jnp.sin(theta) * w_theta * w_phi
    if masking is not None:
        zero = jnp.zeros_like(theta)
        # From the normal nothing is hidden: G is that of o alone.
        p = Pair(zero, zero, zero + 1.0, zero + s, zero, zero + c)
        total = total * MASKINGS[masking](p, h, normals) * 4.0 * c
    return jnp.sum(total)
