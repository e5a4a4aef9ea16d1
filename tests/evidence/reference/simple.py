"""Lambert, modified Phong, Blinn-Phong, Ashikhmin-Shirley, metallic-roughness: all but a diffuse kd/pi."""

from __future__ import annotations

from collections.abc import Mapping

from mpmath import mp, mpf

from fitter.spec import ModelSpec
from tests.evidence.reference.fresnel import fresnel
from tests.evidence.reference.geometry import Pair
from tests.evidence.reference.lafortune import cut_power
from tests.evidence.reference.torrance_sparrow import microfacets


def phong(spec: ModelSpec, values: Mapping[str, mpf], p: Pair) -> mpf:
    """Lafortune and Willems 1994: ks (n+2)/(2 pi) max(0, R(wi).wo)^n."""
    n = values["n"]
    return values["ks"] * (n + 2) / (2 * mp.pi) * cut_power(p.iz * p.oz - p.across, n)


def blinn_phong(spec: ModelSpec, values: Mapping[str, mpf], p: Pair) -> mpf:
    """Blinn 1977; scaled so that the albedo at normal incidence is ks."""
    n = values["n"]
    scale = (n + 2) * (n + 4) / (8 * mp.pi * (mpf(2) ** (-n / 2) + n))
    return values["ks"] * scale * (1 + p.half.tan2) ** (-n / 2)


def ashikhmin_shirley(spec: ModelSpec, values: Mapping[str, mpf], p: Pair) -> mpf:
    """Ashikhmin and Shirley 2000, specular and diffuse."""
    rd, rs, nu, nv = (values[name] for name in ("rd", "rs", "nu", "nv"))
    half, turned = p.half, p.half.turned(values["psi"])
    across = turned.x**2 + turned.y**2
    exponent = (nu * turned.x**2 + nv * turned.y**2) / across if across else mpf(0)
    lobe = mp.sqrt((nu + 1) * (nv + 1)) / (8 * mp.pi) * (1 + half.tan2) ** (-exponent / 2)
    f = rs + (1 - rs) * p.schlick
    body = 28 * rd / (23 * mp.pi) * (1 - rs) * (1 - (1 - p.iz / 2) ** 5) * (1 - (1 - p.oz / 2) ** 5)
    return f * lobe / (p.cos_d * max(p.iz, p.oz)) + body


def metallic_roughness(spec: ModelSpec, values: Mapping[str, mpf], p: Pair) -> mpf:
    """glTF 2.0, appendix B: (1 - F) c_diffuse/pi + F D G/(4 cos cos), alpha = roughness^2, at least 1e-4."""
    color, metallic = values["base_color"], values["metallic"]
    alpha = {"alpha": max(values["roughness"] ** 2, mpf(1e-4)), "ks": mpf(1)}
    f0 = mpf("0.04") * (1 - metallic) + color * metallic
    f = fresnel("schlick", {"f0": f0}, p)
    facets = microfacets("ggx", "smith", "none", alpha, p)
    return (1 - f) * color * (1 - metallic) / mp.pi + f * facets
