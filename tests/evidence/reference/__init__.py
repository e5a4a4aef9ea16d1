"""f_r of every closed-form model in arbitrary precision: the judge of the numerical code.

Derived from the papers named in each module and from the expressions the project calls canonical, and written
without a look at ``fitter/models``: plain formulas, no regard for rounding. Directions and parameters are the
stored floating-point numbers, taken as exact and never renormalised.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from mpmath import mp, mpf

from fitter.spec import ModelSpec
from tests.evidence.reference.geometry import Pair
from tests.evidence.reference.he_torrance import he_torrance
from tests.evidence.reference.lafortune import lafortune
from tests.evidence.reference.layered import layered
from tests.evidence.reference.oren_nayar import oren_nayar
from tests.evidence.reference.simple import ashikhmin_shirley, blinn_phong, metallic_roughness, phong
from tests.evidence.reference.torrance_sparrow import coupled, torrance_sparrow
from tests.evidence.reference.transmission import rough_dielectric
from tests.evidence.reference.ward import ward

__all__ = ["DIGITS", "PARTS", "has_reference", "reference"]

#: Decimal digits callers set (mp.workdps): 50 that count, and what finite differences cost.
DIGITS = 70

#: Prefixes of the parameters of a sum's components.
PARTS = "abcdef"

_MODELS: Mapping[str, Callable[[ModelSpec, Mapping[str, mpf], Pair], mpf]] = {
    "ward": ward,
    "torrance_sparrow": torrance_sparrow,
    "cook_torrance": torrance_sparrow,
    "lafortune": lafortune,
    "oren_nayar": oren_nayar,
    "lambert": lambda spec, values, p: values["kd"] / mp.pi,
    "phong": phong,
    "blinn_phong": blinn_phong,
    "ashikhmin_shirley": ashikhmin_shirley,
    "metallic_roughness": metallic_roughness,
    "rough_dielectric": rough_dielectric,
    "he_torrance": he_torrance,
}

#: Delta components are never a number: their share of a value is 0.
_DELTAS = ("specular",)


def has_reference(spec: ModelSpec) -> bool:
    """Whether :func:`reference` knows the model: closed forms, and composites of them."""
    known = spec.family in _MODELS or spec.family in ("sum", "layered") or spec.family in _DELTAS
    return known and all(has_reference(part) for part in spec.components)


def reference(spec: ModelSpec, values: Mapping[str, mpf], components: Sequence[mpf]) -> mpf:
    """f_r of one channel, 1/sr, to the working precision of mpmath.

    values : the model's parameters by their names; components : ix, iy, iz, ox, oy, oz.
    """
    p = Pair(*components)
    if spec.family == "sum":
        parts = zip(PARTS, spec.components, strict=False)
        return mp.fsum(reference(part, _under(f"{letter}_", values), p) for letter, part in parts)
    if spec.family == "rough_dielectric":
        return rough_dielectric(spec, values, p)
    if not p.above or spec.family in _DELTAS:
        return mpf(0)
    if spec.family == "layered":
        base, inner = spec.components[0], _under("base_", values)
        return layered(spec, values, p, lambda inside: reference(base, inner, inside))
    found = _MODELS[spec.family](spec, values, p)
    if spec.diffuse == "coupled":
        return found + coupled(spec, values, p)
    # he_torrance has its diffuse term whatever the options say.
    additive = spec.diffuse == "lambert" or spec.family == "he_torrance"
    return found + values["kd"] / mp.pi if additive and "kd" in values else found


def _under(prefix: str, values: Mapping[str, mpf]) -> dict[str, mpf]:
    return {name.removeprefix(prefix): v for name, v in values.items() if name.startswith(prefix)}
