"""Random hard cases: pairs of directions and parameter values over the whole domain the models promise.

Strata (a share of the points each): generic directions; one or both grazing, cos theta log-uniform from 1e-6;
near mirror and near retro, 1e-8 rad to 1; opposed and grazing; exactly or nearly normal; special azimuths;
and three that look for the lobe of the drawn roughness: about the mirror direction, the retro direction and
the normal, where what is being judged does not underflow.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from fitter.models import Parameter

Floats = NDArray[np.float64]
Rng = np.random.Generator

LOWEST_COSINE = 1e-6

#: Stratum -> share of the points.
STRATA: Mapping[str, float] = {
    "generic": 0.10, "grazing_one": 0.10, "grazing_both": 0.08, "mirror": 0.12, "retro": 0.08,
    "opposed": 0.08, "normal": 0.08, "azimuth": 0.10, "mirror_lobe": 0.16, "retro_lobe": 0.05,
    "normal_lobe": 0.05,
}  # fmt: skip

#: n + i k of metals in the visible: silver, aluminium, gold, copper, tungsten, chromium, iron, titanium.
METALS = (
    (0.05, 3.3), (0.135, 3.99), (1.02, 6.63), (0.96, 6.69), (0.18, 3.43), (1.50, 1.88), (0.24, 3.42),
    (3.50, 2.72), (3.14, 3.31), (2.91, 2.97), (1.92, 2.81),
)  # fmt: skip


def directions(rng: Rng, widths: Floats, *, below: bool = False) -> tuple[Floats, Floats, NDArray[np.str_]]:
    """wi and wo (N, 3), and the stratum of each (N,); ``widths`` (N,) are the tangents of the lobes' widths.

    below : either direction may lie below the surface (transmission).
    """
    n = len(widths)
    stratum = rng.choice(list(STRATA), n, p=np.array(list(STRATA.values())) / sum(STRATA.values()))
    wi, wo = np.empty((n, 3)), np.empty((n, 3))
    for k in range(n):
        wi[k], wo[k] = _PAIRS[stratum[k]](rng, widths[k])
        if rng.random() < 0.5:
            wi[k], wo[k] = wo[k].copy(), wi[k].copy()
    if below:
        for w in (wi, wo):
            w[:, 2] *= np.where(rng.random(n) < 0.5, -1.0, 1.0)
    return wi, wo, stratum


def _direction(cosine: float, phi: float) -> Floats:
    # 1 - c^2 as a product: the sine of a direction near the normal keeps its digits.
    sine = np.sqrt((1 - cosine) * (1 + cosine))
    return np.array([sine * np.cos(phi), sine * np.sin(phi), cosine])


def _phi(rng: Rng) -> float:
    return float(rng.uniform(-np.pi, np.pi))


def _cosine(rng: Rng) -> float:
    return float(rng.uniform(0.02, 1.0))


def _grazing(rng: Rng) -> float:
    return float(np.exp(rng.uniform(np.log(LOWEST_COSINE), 0.0))) if rng.random() > 0.1 else LOWEST_COSINE


def _either(rng: Rng) -> float:
    return _grazing(rng) if rng.random() < 0.5 else _cosine(rng)


def _log(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _near(rng: Rng, axis: Floats, angle: float) -> Floats:
    """A direction at about ``angle`` from ``axis``, kept above the horizon."""
    offset = rng.normal(size=3)
    offset -= axis * (offset @ axis)
    found = axis + offset * (np.tan(min(angle, 1.4)) / max(float(np.linalg.norm(offset)), 1e-300))
    return _above(found)


def _above(w: Floats) -> Floats:
    """Normalised, at least LOWEST_COSINE above the horizon."""
    w = w / np.linalg.norm(w)
    across = float(np.hypot(w[0], w[1]))
    if abs(w[2]) < LOWEST_COSINE or across == 0:
        phi = float(np.arctan2(w[1], w[0]))
        return _direction(LOWEST_COSINE if across else 1.0, phi)
    return w * np.array([1, 1, np.sign(w[2])])


def _mirrored(w: Floats) -> Floats:
    return w * np.array([-1, -1, 1])


def _generic(rng: Rng, width: float) -> tuple[Floats, Floats]:
    return _direction(_cosine(rng), _phi(rng)), _direction(_cosine(rng), _phi(rng))


def _grazing_one(rng: Rng, width: float) -> tuple[Floats, Floats]:
    return _direction(_grazing(rng), _phi(rng)), _direction(_cosine(rng), _phi(rng))


def _grazing_both(rng: Rng, width: float) -> tuple[Floats, Floats]:
    return _direction(_grazing(rng), _phi(rng)), _direction(_grazing(rng), _phi(rng))


def _mirror(rng: Rng, width: float) -> tuple[Floats, Floats]:
    wi = _direction(_either(rng), _phi(rng))
    exact = rng.random() < 0.1
    return wi, _mirrored(wi) if exact else _near(rng, _mirrored(wi), _log(rng, 1e-8, 1.0))


def _retro(rng: Rng, width: float) -> tuple[Floats, Floats]:
    wi = _direction(_either(rng), _phi(rng))
    return wi, wi.copy() if rng.random() < 0.1 else _near(rng, wi, _log(rng, 1e-8, 1.0))


def _opposed(rng: Rng, width: float) -> tuple[Floats, Floats]:
    phi, low = _phi(rng), _log(rng, LOWEST_COSINE, 1e-2)
    turned = phi + np.pi + (0.0 if rng.random() < 0.2 else _log(rng, 1e-8, 0.3))
    other = low if rng.random() < 0.2 else _log(rng, LOWEST_COSINE, 1e-2)
    return _direction(low, phi), _direction(other, turned)


def _normal(rng: Rng, width: float) -> tuple[Floats, Floats]:
    kind = rng.integers(4)
    wi = _direction(1.0, 0.0) if kind < 2 else _near(rng, np.array([0.0, 0.0, 1.0]), _log(rng, 1e-9, 1e-2))
    if kind == 0:
        return wi, wi.copy()
    return wi, _direction(_either(rng), _phi(rng)) if kind != 3 else _near(rng, wi, _log(rng, 1e-9, 1e-2))


def _azimuth(rng: Rng, width: float) -> tuple[Floats, Floats]:
    """In the xz or yz plane, in one plane, across it, and at equal angles: where terms have their kinks."""
    a, b = _either(rng), _either(rng)
    b = a if rng.random() < 0.3 else b
    phi = float(rng.choice([0.0, 0.5, 1.0, -0.5]) * np.pi) if rng.random() < 0.5 else _phi(rng)
    turned = phi + float(rng.choice([0.0, 0.5, 1.0, -0.5])) * np.pi
    wi, wo = _direction(a, phi), _direction(b, turned)
    if rng.random() < 0.5:
        # Components that are exactly zero, as a grid of angles has them.
        wi[np.abs(wi) < 1e-15] = 0.0
        wo[np.abs(wo) < 1e-15] = 0.0
    return wi, wo


def _mirror_lobe(rng: Rng, width: float) -> tuple[Floats, Floats]:
    wi = _direction(_either(rng), _phi(rng))
    tangent, phi = width * _log(rng, 0.05, 15.0), _phi(rng)
    h = np.array([tangent * np.cos(phi), tangent * np.sin(phi), 1.0])
    h /= np.linalg.norm(h)
    wo = 2 * (wi @ h) * h - wi
    return wi, _above(wo) if wo[2] > 0 else _mirrored(wi)


def _retro_lobe(rng: Rng, width: float) -> tuple[Floats, Floats]:
    wi = _direction(_either(rng), _phi(rng))
    return wi, _near(rng, wi, min(1.4, width * _log(rng, 0.05, 5.0)))


def _normal_lobe(rng: Rng, width: float) -> tuple[Floats, Floats]:
    up, angle = np.array([0.0, 0.0, 1.0]), min(1.4, width * _log(rng, 0.05, 5.0))
    return _near(rng, up, angle), _near(rng, up, angle)


_PAIRS: Mapping[str, Callable[[Rng, float], tuple[Floats, Floats]]] = {
    "generic": _generic, "grazing_one": _grazing_one, "grazing_both": _grazing_both, "mirror": _mirror,
    "retro": _retro, "opposed": _opposed, "normal": _normal, "azimuth": _azimuth, "mirror_lobe": _mirror_lobe,
    "retro_lobe": _retro_lobe, "normal_lobe": _normal_lobe,
}  # fmt: skip


# Parameters -----------------------------------------------------------------------------------------


def _mixed(ends: tuple[float, ...], *parts: Callable[[Rng], float]) -> Callable[[Rng], float]:
    """One in seven an exact end or special value, else one of the parts."""

    def draw(rng: Rng) -> float:
        if ends and rng.random() < 1 / 7:
            return float(rng.choice(ends))
        return parts[int(rng.integers(len(parts)))](rng)

    return draw


def _uniform(low: float, high: float) -> Callable[[Rng], float]:
    return lambda rng: float(rng.uniform(low, high))


def _logarithmic(low: float, high: float) -> Callable[[Rng], float]:
    return lambda rng: _log(rng, low, high)


_SCALE = _mixed((1.0,), _uniform(0.0, 1.0), _logarithmic(1e-6, 1.0))
_DIFFUSE = _mixed((0.0, 1.0), _uniform(0.0, 1.0), lambda rng: 0.0)
_SHARE = _mixed((0.0, 1.0), _uniform(0.0, 1.0), _logarithmic(1e-6, 1.0))
_ALPHA = _mixed((1e-4, 1.0), _logarithmic(1e-4, 1.0), _logarithmic(1e-4, 1.0), _uniform(0.05, 1.0))
_EXPONENT = _mixed((0.0, 1.0, 2.0, 1e6), _logarithmic(1e-3, 1e6), _logarithmic(1.0, 1e6))
_TURN = _mixed((0.0, np.pi / 2, -np.pi / 2, np.pi), _uniform(-np.pi, np.pi))
_AXIS = _mixed(
    (0.0, np.pi / 4, -np.pi / 4, np.pi / 2, 3 * np.pi / 4), _uniform(-np.pi, np.pi), lambda rng: np.pi / 4
)
_SIGMA = _mixed((0.0, 1.0, np.pi / 2), _uniform(0.0, np.pi / 2), _logarithmic(1e-6, 1.0))
_INDEX = _mixed((1.05, 1.33, 1.5, 2.5), _uniform(1.05, 2.5))
_EITHER_INDEX = _mixed((0.4, 1 / 1.5, 1.5, 2.5), _uniform(1.05, 2.5), _uniform(0.4, 0.95))

#: What each parameter is drawn from, by its name without the prefixes and suffixes of components and lobes.
RULES: Mapping[str, Callable[[Rng], float]] = {
    "kd": _DIFFUSE, "ks": _SCALE, "kt": _SCALE, "rho": _SHARE, "rd": _DIFFUSE, "rs": _SHARE, "f0": _SHARE,
    "base_color": _SHARE, "metallic": _SHARE,
    "alpha": _ALPHA, "alpha_x": _ALPHA, "alpha_y": _ALPHA,
    "roughness": _mixed((1e-2, 1.0), _logarithmic(1e-2, 1.0), _uniform(0.05, 1.0)),
    "n": _EXPONENT, "nu": _EXPONENT, "nv": _EXPONENT,
    "s": _mixed((1e-3, 2.0), _logarithmic(1e-3, 2.0)),
    "sigma": _SIGMA, "psi": _TURN, "delta": _TURN, "gamma": _AXIS, "eta": _INDEX,
    "tau": _mixed((0.0,), _logarithmic(1e-4, 10.0), _uniform(0.0, 3.0)),
}  # fmt: skip

#: Of a surface with a height and a correlation length in wavelengths, where the names mean another thing.
WAVES: Mapping[str, Callable[[Rng], float]] = {
    "sigma": _mixed((0.0, 10.0), _logarithmic(1e-4, 10.0), _uniform(0.0, 2.0)),
    "tau": _mixed((0.5, 1000.0), _logarithmic(0.5, 1000.0)),
}

#: The ranges the models promise; a table that allows less is a finding.
PROMISED: Mapping[str, tuple[float, float]] = {
    "alpha": (1e-4, 1.0), "alpha_x": (1e-4, 1.0), "alpha_y": (1e-4, 1.0), "n": (0.0, 1e6), "nu": (0.0, 1e6),
    "nv": (0.0, 1e6), "f0": (0.0, 1.0), "eta": (1.05, 2.5), "rho": (0.0, 1.0),
    "rs": (0.0, 1.0), "rd": (0.0, 1.0),
}  # fmt: skip

_PREFIX = re.compile(r"^(?:[a-f]_|base_|facet_)")
_LOBE = re.compile(r"_[1-3]$")


def plain_name(name: str) -> str:
    """A parameter's name without the prefixes of components and the number of a lobe."""
    while name not in RULES and name != "kappa" and _PREFIX.match(name):
        name = _PREFIX.sub("", name, count=1)
    return _LOBE.sub("", name)


def values(rng: Rng, table: Iterable[Parameter], count: int, *, inside_too: bool) -> dict[str, Floats]:
    """Parameter values (N,) each, within the table's bounds. LookupError for a name there is no rule for.

    inside_too : indices below 1 too (a denser medium above).
    """
    table = tuple(table)
    names = [p.name for p in table]
    found: dict[str, Floats] = {}
    for p in table:
        plain = plain_name(p.name)
        if plain == "kappa":
            continue
        partner = p.name.removesuffix("eta") + "kappa"
        if plain == "eta" and partner in names:
            found[p.name], found[partner] = _metals(rng, count)
            continue
        waves = plain in WAVES and {p.name[: -len(plain)] + other for other in WAVES} <= set(names)
        rule = _EITHER_INDEX if plain == "eta" and inside_too else WAVES[plain] if waves else RULES[plain]
        found[p.name] = np.array([rule(rng) for _ in range(count)])
    return {p.name: np.clip(found[p.name], p.lower, p.upper) for p in table}


def _metals(rng: Rng, count: int) -> tuple[Floats, Floats]:
    pairs = np.array([METALS[k] for k in rng.integers(len(METALS), size=count)])
    spread = rng.random(count) < 0.5
    n, k = rng.uniform(0.04, 4.0, count), rng.uniform(0.5, 8.0, count)
    return np.where(spread, n, pairs[:, 0]), np.where(spread, k, pairs[:, 1])


def narrower(table: Iterable[Parameter]) -> list[str]:
    """Parameters whose bounds leave out part of what is promised."""
    told: list[str] = []
    for p in table:
        low, high = PROMISED.get(plain_name(p.name), (p.lower, p.upper))
        if plain_name(p.name) == "eta" and any(other.name.endswith("kappa") for other in table):
            low, high = 0.05, 4.0
        if p.lower > low or p.upper < high:
            told.append(f"{p.name} is bounded to [{p.lower:g}, {p.upper:g}], promised is [{low:g}, {high:g}]")
    return told


def lobe_width(found: Mapping[str, Floats], count: int) -> Floats:
    """A tangent of the order of the narrowest lobe of each point: alpha, s, n^(-1/2), roughness^2."""
    width = np.ones(count)
    for name, v in found.items():
        plain = plain_name(name)
        if plain in ("alpha", "alpha_x", "alpha_y", "s"):
            width = np.minimum(width, v)
        elif plain in ("n", "nu", "nv"):
            width = np.minimum(width, 1 / np.sqrt(v + 1))
        elif plain == "roughness":
            width = np.minimum(width, v * v)
        elif plain == "sigma" and (tau := name[: -len(plain)] + "tau") in found:
            width = np.minimum(width, np.maximum(1 / found[tau], v / found[tau]))
    return width
