"""Virtual gonioreflectometer: light traced from a collimated source over an explicit surface to receivers.

Photons enter uniformly over one period of the height field, so that shadowing, masking and multiple
bounces are what the geometry makes them. A facet reflects specularly by its exact Fresnel reflectance;
what enters a dielectric facet comes out again diffusely. Receivers are cones: specular photons are
counted in them; diffuse light is sent to them from a random part of the hits, with a visibility ray each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from surface import FloatArray, HeightField, IntArray

#: Photons traced together.
BATCH = 131_072
#: Receivers whose visibility rays are traced together.
GROUP = 16
#: Steps of the R2 sequence: inverse powers of the root of x^3 = x + 1. Photons enter evenly over the surface.
EVENLY = np.array([0.7548776662466927, 0.5698402909980532])
#: Bounces after which photons play Russian roulette with their largest weight, and the last one traced.
ROULETTE_AFTER, MOST_BOUNCES = 3, 200


@dataclass(frozen=True)
class Facet:
    """What a microscopic facet is made of.

    ``kind`` is "lambert" (``albedo``), "dielectric" (``eta`` and the ``albedo`` of the Lambertian body under
    the smooth interface) or "conductor" (``eta``, ``k``; the share ``matte`` of its area is covered by
    specks with a Lambertian ``albedo``). Each property has one entry a channel.
    """

    kind: str
    albedo: FloatArray
    eta: FloatArray
    k: FloatArray
    matte: FloatArray

    @classmethod
    def create(cls, kind: str, channels: int = 3, **given: float | list[float]) -> Facet:
        """From plain numbers or lists; a number holds for every channel."""
        full = {
            name: np.broadcast_to(np.asarray(given.get(name, 0.0), np.float64), channels).copy()
            for name in ("albedo", "eta", "k", "matte")
        }
        return cls(kind, **full)

    @property
    def channels(self) -> int:
        return len(self.albedo)

    def specular(self, cos: FloatArray) -> FloatArray:
        """Unpolarised Fresnel reflectance (C, N) at cosines (N,) from air, of what is not matte."""
        if self.kind == "lambert":
            return np.zeros((self.channels, len(cos)))
        # Complex Snell: cos_t = sqrt(1 - sin^2 / m^2), m = eta + i k (Born & Wolf, Principles of Optics).
        m = (self.eta + 1j * self.k)[:, None]
        inside = np.sqrt(1.0 - (1.0 - cos**2) / m**2)
        s = (cos - m * inside) / (cos + m * inside)
        p = (m * cos - inside) / (m * cos + inside)
        return (1.0 - self.matte)[:, None] * 0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2)

    def body(self, cos_i: FloatArray, cos_o: FloatArray) -> FloatArray:
        """Diffuse BRDF of the facet (C, N) in 1/sr.

        Under a dielectric interface: the fraction 1 - F(i) enters, is scattered by a Lambertian base, leaves
        in part or is thrown back, and so on (Saunderson 1942, J. Opt. Soc. Am. 32, 727). Summing the
        series gives a reciprocal function that keeps all energy at albedo 1.
        """
        if self.kind != "dielectric":
            share = self.matte if self.kind == "conductor" else 1.0
            return np.repeat((share * self.albedo / np.pi)[:, None], len(cos_i), axis=1)
        node, weight = np.polynomial.legendre.leggauss(64)
        mu = 0.5 * (node + 1.0)
        outside = (self.specular(mu) * (weight * mu)).sum(axis=1)
        inside = 1.0 - (1.0 - outside) / self.eta**2
        base = self.albedo / (np.pi * self.eta**2 * (1.0 - self.albedo * inside))
        return base[:, None] * (1.0 - self.specular(cos_i)) * (1.0 - self.specular(cos_o))

    def specular_chance(self) -> float:
        """Chance that a photon takes the specular branch; weights make up for it.

        High where there are both: only specular photons need counting, body light is gathered from arrivals.
        """
        if self.kind == "conductor":
            return 0.9 if self.matte.any() else 1.0
        return 0.0 if self.kind == "lambert" else 0.8


@dataclass(frozen=True)
class Arrivals:
    """Every meeting of ``photons`` photons with a facet: where, from where, and with what weight."""

    photons: int
    position: FloatArray  # (3, M)
    normal: FloatArray  # (3, M)
    direction: FloatArray  # (3, M), of travel
    weight: FloatArray  # (C, M)
    azimuth: FloatArray  # (M,) of the sample


@dataclass(frozen=True)
class Light:
    """What came of ``photons`` photons. ``albedo`` (C,) is the escaped share, with its standard error."""

    photons: int
    albedo: FloatArray
    albedo_error: FloatArray
    glints: FloatArray  # (3, G) directions of photons whose last reflection was specular
    glint_weight: FloatArray  # (C, G)
    arrivals: Arrivals


def turn(v: FloatArray, azimuth: FloatArray | float) -> FloatArray:
    """Vectors (3, N) turned about +z."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    return np.stack([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2] + 0.0 * c])


def about(axis: FloatArray, cos: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Unit vectors (3, N) at polar cosine ``cos`` and ``azimuth`` about unit ``axis`` (3, N) with z > -1."""
    a = -1.0 / (1.0 + axis[2])
    b = axis[0] * axis[1] * a
    t = np.stack([1.0 + axis[0] ** 2 * a, b, -axis[0]])
    u = np.stack([b, 1.0 + axis[1] ** 2 * a, -axis[1]])
    sin = np.sqrt(np.maximum(0.0, 1.0 - cos**2))
    return sin * np.cos(azimuth) * t + sin * np.sin(azimuth) * u + cos * axis


def illuminate(
    field: HeightField,
    facet: Facet,
    wi: FloatArray,
    photons: int,
    rng: np.random.Generator,
    *,
    spin: bool,
    keep_arrivals: int = 0,
) -> Light:
    """Trace photons that come from direction ``wi`` (3,).

    ``spin``: the sample turns about its normal during a reading, so that each photon meets it at an
    azimuth of its own. Arrivals of the first ``keep_arrivals`` photons (in whole batches) are kept.
    """
    glints: list[tuple[FloatArray, FloatArray]] = []
    arrivals: list[tuple[FloatArray, ...]] = []
    total, square = np.zeros(facet.channels), np.zeros(facet.channels)
    kept, shift = 0, rng.random(2)
    for start in range(0, photons, BATCH):
        count = min(BATCH, photons - start)
        keep = start < keep_arrivals
        kept += count * keep
        escaped = np.zeros((facet.channels, count))
        azimuth = 2.0 * np.pi * rng.random(count) if spin else np.zeros(count)
        d = -turn(np.broadcast_to(wi[:, None], (3, count)), -azimuth)
        o = np.empty((3, count))
        place = shift[:, None] + np.arange(start, start + count) * EVENLY[:, None]
        o[:2] = field.size * (place - np.floor(place))
        o[2] = field.top + 0.5
        gap = o[2] - field.height_at(o[0], o[1])
        weight, number = np.ones((facet.channels, count)), np.arange(count)
        glinting = np.zeros(count, bool)
        for bounce in range(MOST_BOUNCES):
            hits = field.intersect(o, d, gap)
            away = ~hits.hit
            escaped[:, number[away]] = weight[:, away]
            out = away & glinting
            if out.any():
                glints.append((turn(d[:, out], azimuth[number[out]]), weight[:, out]))
            met = np.flatnonzero(hits.hit)
            if not len(met):
                break
            number, d, weight = number[met], d[:, met], weight[:, met]
            o, n = hits.position[:, met], hits.normal[:, met]
            if keep:
                arrivals.append((o, n, d, weight, azimuth[number]))
            d, factor, glinting = _reflect(facet, n, d, rng)
            weight = weight * factor
            if bounce >= ROULETTE_AFTER:
                survival = np.minimum(1.0, weight.max(axis=0))
                alive = rng.random(len(number)) < survival
                weight = weight[:, alive] / survival[alive]
                number, d, o, glinting = number[alive], d[:, alive], o[:, alive], glinting[alive]
            gap = np.zeros(len(number))
        total += escaped.sum(axis=1)
        square += (escaped**2).sum(axis=1)
    mean = total / photons
    error = np.sqrt(np.maximum(0.0, square / photons - mean**2) / photons)
    empty = [(np.empty((3, 0)), np.empty((facet.channels, 0)))]
    glint, glint_weight = (np.concatenate(part, axis=1) for part in zip(*(glints or empty), strict=True))
    if not arrivals:
        arrivals = [(*[np.empty((3, 0))] * 3, np.empty((facet.channels, 0)), np.empty(0))]
    kept_arrivals = Arrivals(kept, *(np.concatenate(part, axis=-1) for part in zip(*arrivals, strict=True)))
    return Light(photons, mean, error, glint, glint_weight, kept_arrivals)


def _reflect(
    facet: Facet, n: FloatArray, d: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """New directions (3, N), weight factors (C, N) and whether the specular branch was taken."""
    cos = -(n * d).sum(axis=0)
    chance = facet.specular_chance()
    specular = rng.random(len(cos)) < chance
    u, v = rng.random((2, len(cos)))
    cos_o = np.sqrt(1.0 - u)  # cosine-distributed about the facet's normal, never 0
    diffuse = about(n, cos_o, 2.0 * np.pi * v)
    direction = np.where(specular, d + 2.0 * cos * n, diffuse)
    factor = np.where(
        specular,
        facet.specular(cos) / max(chance, 1e-300),
        facet.body(cos, cos_o) * (np.pi / max(1.0 - chance, 1e-300)),
    )
    return direction, factor, specular


def cone_solid_angle(aperture: float) -> float:
    """Solid angle (sr) of a cone with full angle ``aperture`` (radians)."""
    return 4.0 * np.pi * np.sin(0.25 * aperture) ** 2


def count_glints(light: Light, wo: FloatArray, aperture: float) -> tuple[FloatArray, FloatArray]:
    """f_r cos(theta_o) of the specular photons, mean over receivers' cones, and its standard error.

    ``wo`` (3, R) are the cones' axes, ``aperture`` their full angle in radians; both results (R, C).
    """
    value, square = np.zeros((2, wo.shape[1], len(light.glint_weight)))
    if light.glints.shape[1]:
        # The chord of an angle a is 2 sin(a / 2).
        inside = cKDTree(light.glints.T).query_ball_point(
            wo.T, 2.0 * np.sin(0.25 * aperture), return_sorted=True
        )
        for r, photons in enumerate(inside):
            w = light.glint_weight[:, np.asarray(photons, np.int64)]
            value[r], square[r] = w.sum(axis=1), (w**2).sum(axis=1)
    unit = light.photons * cone_solid_angle(aperture)
    return value / unit, np.sqrt(square) / unit


def gather_body(
    field: HeightField,
    facet: Facet,
    arrivals: Arrivals,
    wo: FloatArray,
    aperture: float,
    rays: int,
    rngs: list[np.random.Generator],
) -> tuple[FloatArray, FloatArray]:
    """f_r cos(theta_o) of the diffuse light, mean over receivers' cones, and its standard error; both (R, C).

    Each receiver (axes ``wo`` (3, R), one generator each) looks at ``rays`` random arrivals from a
    random direction of its cone.
    """
    value, error = np.zeros((2, wo.shape[1], facet.channels))
    if facet.specular_chance() == 1.0:
        return value, error
    met = arrivals.position.shape[1]
    for start in range(0, wo.shape[1], GROUP):
        group = range(start, min(start + GROUP, wo.shape[1]))
        index = np.concatenate([_indices(rngs[r], met, rays) for r in group])
        u, v = np.concatenate([rngs[r].random((2, rays)) for r in group], axis=1)
        axis = np.repeat(wo[:, group.start : group.stop], rays, axis=1)
        cos = 1.0 - u * (1.0 - np.cos(0.5 * aperture))
        to = turn(about(axis, cos, 2.0 * np.pi * v), -arrivals.azimuth[index])
        n = arrivals.normal[:, index]
        cos_i, cos_o = -(n * arrivals.direction[:, index]).sum(axis=0), (n * to).sum(axis=0)
        facing = np.flatnonzero((cos_o > 0) & (to[2] > 0))
        seen = facing[
            ~field.intersect(arrivals.position[:, index[facing]], to[:, facing], np.zeros(len(facing))).hit
        ]
        sent = np.zeros((facet.channels, len(index)))
        sent[:, seen] = (
            arrivals.weight[:, index[seen]] * facet.body(cos_i[seen], cos_o[seen]) * cos_o[seen]
        )
        sent = (sent * (met / arrivals.photons)).reshape(facet.channels, len(group), rays)
        value[group.start : group.stop] = sent.mean(axis=2).T
        error[group.start : group.stop] = (sent.std(axis=2) / np.sqrt(rays)).T
    return value, error


def _indices(rng: np.random.Generator, below: int, count: int) -> IntArray:
    return (rng.random(count) * below).astype(np.int64)
