"""Lines that several families share: the half vector, slopes, the axes of roughness."""

from __future__ import annotations

HALF = (
    "# The half vector, not normalised.",
    "hx = ix + ox",
    "hy = iy + oy",
    "hz = iz + oz",
    "h2 = hx*hx + hy*hy + hz*hz",
)


def turn(*prefixes: str) -> list[str]:
    """Components px, py of vectors, as pu, pv along the axes of roughness, which psi turns."""
    lines = ["c_psi = cos(psi)", "s_psi = sin(psi)"]
    for p in prefixes:
        lines += [f"{p}u = c_psi*{p}x + s_psi*{p}y", f"{p}v = c_psi*{p}y - s_psi*{p}x"]
    return lines


def slopes(anisotropic: bool) -> list[str]:
    """``slope2``, the squared slope of the half vector in units of the roughness, and ``area``."""
    if anisotropic:
        return [
            *turn("h"), "tu = hu / (alpha_x*hz)", "tv = hv / (alpha_y*hz)", "slope2 = tu*tu + tv*tv",
            "area = alpha_x*alpha_y",
        ]  # fmt: skip
    return [
        "tx = hx / (alpha*hz)", "ty = hy / (alpha*hz)", "slope2 = tx*tx + ty*ty", "area = alpha*alpha",
    ]  # fmt: skip


def projected(anisotropic: bool) -> list[str]:
    """``pi2``, ``po2``: squared lengths of the horizontal components of wi and wo times the roughness."""
    if anisotropic:
        lines = [line for line in turn("i", "o") if not line.endswith("(psi)")]
        for d in "io":
            lines += [f"p{d}u = alpha_x*{d}u", f"p{d}v = alpha_y*{d}v", f"p{d}2 = p{d}u*p{d}u + p{d}v*p{d}v"]
        return lines
    return [f"p{d}2 = alpha*alpha*({d}x*{d}x + {d}y*{d}y)" for d in "io"]


def with_diffuse(diffuse: str | None, lobe: str) -> str:
    """The sum of the Lambertian term, where there is one, and ``lobe``."""
    return lobe if diffuse == "none" else f"kd / PI + {lobe}"
