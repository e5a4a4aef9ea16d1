"""A model in the adaptive parameterisation, sampled at the same half vectors for every incidence.

The format (:mod:`fitter.sampling.parameterisation`) blends the places of samples between incidences as well
as their values. Where the places are the same everywhere only values are blended, and at a fixed half vector
m those hardly depend on the incidence. Two things more make them smooth: the distribution of normals is the
model's own, as the database's makers measure it, by retro-reflection (J. Dupuy, W. Jakob 2018),

    D(m) = 4 sigma(m) f_r(m, m) cos(theta_m),

and samples lie by the root of a mixture of GGX distributions as wide as the lobe and wider, per unit of the
square: denser in the lobe, but not scarce beside it.

What the file says of a pair of directions depends on 8 samples, or 16 of an anisotropic surface: so its error
is known before it is written, and the resolution is chosen by that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.export.fidelity import compared_pairs, seen
from fitter.export.lobe import lobe_of
from fitter.export.subject import Subject
from fitter.formats.rgl_writer import Float32Array, mixture
from fitter.sampling.parameterisation import Adaptive
from fitter.sampling.warp import Corner, Warp, lookup

FloatArray = NDArray[np.float64]

#: Incident angles, steps between the azimuths of a whole turn, and samples of an incidence on each axis: from
#: the coarsest that is written to the finest.
_THETA = (31, 41, 61, 91, 121, 181)
_PHI = (24, 32, 48, 64, 96, 128)
_STEPS = (48, 64, 80, 96, 128, 160, 192, 224)
#: The p95 that is aimed at, below the 1 % that is stated: what is predicted is of these few pairs.
_GOAL, _PAIRS = 0.007, 2000
#: No file is made larger than this for the sake of it.
LARGEST = 128_000_000
#: Nodes of the density that places samples, of the distribution of normals, of the projected area.
_PLACES, _NORMALS, _AREA = 64, 512, 128
#: Where incidences end, and how far above the horizon retro-reflection is asked for.
_LAST, _LOWEST = np.deg2rad(89.9), 1e-3
#: The share of the mixture in the distribution of normals, where retro-reflection vanishes.
_FLOOR = 1e-10
#: Samples that are evaluated together.
_TOGETHER = 65536
#: What a symmetry has to hold to.
_SAME = 1e-9


@dataclass(frozen=True)
class Resolution:
    """Incident angles, azimuths of a whole turn and samples on each axis, by their place in the lists."""

    theta: int = 0
    phi: int = 0
    steps: int = 0

    def finer(self, isotropic: bool) -> Iterator[Resolution]:
        """Those that are one step finer on one axis."""
        for name, most in (("theta", _THETA), ("phi", () if isotropic else _PHI), ("steps", _STEPS)):
            if getattr(self, name) + 1 < len(most):
                yield replace(self, **{name: getattr(self, name) + 1})


class HalfVectors:
    """Where the samples of a model lie, and what they are."""

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self.isotropic = subject.symmetry == "isotropic"
        self.wi, self.wo = compared_pairs(subject, _PAIRS)
        self.ours = subject.evaluate(self.wi, self.wo)[0]
        self.folds = 1 if self.isotropic else self._folds()
        lobe = lobe_of(subject)
        self.sigma = self._image(mixture(lobe, _nodes(_AREA, 1 if self.isotropic else _AREA)[0])[1])
        m, unit = _nodes(_PLACES, 1 if lobe.along == lobe.across else _PLACES)
        places = np.sqrt(mixture(lobe, m)[0] * unit) * np.ones((_PLACES, 1))
        self.places: Float32Array = (places / places.mean()).astype(np.float32)
        self.warp = Warp(self.places[None])
        m, _ = _nodes(_NORMALS, 1 if self.isotropic else _NORMALS)
        mixed, area = mixture(lobe, m)
        found: list[tuple[float, Float32Array]] = []
        # A lobe about another direction may not be seen in retro-reflection: then the mixture does better.
        for ndf in (self._retro(m, area) + _FLOOR * mixed, mixed):
            self.ndf = self._image(ndf * (mixed.max() / ndf.max()))
            found.append((self.error(Resolution()), self.ndf))
        self.ndf = min(found, key=lambda entry: entry[0])[1]

    def _image(self, rows: FloatArray) -> Float32Array:
        # One row does where no azimuth differs; the format wants two.
        return np.tile(rows, (2 if self.isotropic else 1, 1)).astype(np.float32)

    def _retro(self, m: FloatArray, area: FloatArray) -> FloatArray:
        """The distribution of normals (rows, count) that retro-reflection shows, its largest value 1."""
        lifted = np.concatenate([m[..., :2], np.maximum(m[..., 2:], _LOWEST)], axis=-1).reshape(-1, 3)
        lifted /= np.linalg.norm(lifted, axis=1)[:, None]
        value = self.subject.evaluate(lifted, lifted)[0].mean(axis=1) * lifted[:, 2] * area.reshape(-1)
        value = np.where(np.isfinite(value), np.maximum(value, 0.0), 0.0)
        return (value / max(float(value.max()), np.finfo(float).tiny)).reshape(area.shape)

    def _folds(self) -> int:
        """By how much a turn of incident azimuths can be folded: 4 mirrored in x and y, 2 turned by pi."""
        for folds, sign in ((4, [[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0]]), (2, [[-1.0, -1.0, 1.0]])):
            there = [self.subject.evaluate(self.wi * one, self.wo * one)[0] for one in np.asarray(sign)]
            if all(np.allclose(value, self.ours, rtol=_SAME, atol=0.0) for value in there):
                return folds
        return 1

    def incidences(self, at: Resolution) -> tuple[FloatArray, FloatArray]:
        """Incident angles (T,) and azimuths (P,), as float32 holds them."""
        theta = np.linspace(0.0, _LAST, _THETA[at.theta])
        phi = np.zeros(1)
        if not self.isotropic:
            phi = np.linspace(-np.pi, -np.pi + 2 * np.pi / self.folds, _PHI[at.phi] // self.folds + 1)
        return theta.astype(np.float32).astype(np.float64), phi.astype(np.float32).astype(np.float64)

    def size(self, at: Resolution) -> int:
        """Bytes of a file, but for a few."""
        theta, phi = self.incidences(at)
        samples = _STEPS[at.steps] ** 2 * (4 * max(len(self.subject.channels), 3) + 5)
        return len(theta) * len(phi) * (samples + 4 * _PLACES**2) + 4 * (self.ndf.size + self.sigma.size)

    def chosen(self) -> Resolution:
        """The smallest file that is expected to keep to the goal, or the largest allowed: each time the axis
        is refined that gains most for its bytes."""
        best = Resolution()
        error = self.error(best)
        while error > _GOAL:
            finer = [one for one in best.finer(self.isotropic) if self.size(one) <= LARGEST]
            found = [(self.error(one), one) for one in finer]
            better = [
                ((error - e) / np.log(self.size(one) / self.size(best)), e, one)
                for e, one in found
                if e < error
            ]
            if not better:
                break
            _, error, best = max(better, key=lambda entry: entry[0])
        return best

    def error(self, at: Resolution) -> float:
        """The 95 % quantile of the relative error that a file of this resolution will have."""
        known = seen(self.ours)
        if not known.any():
            return 0.0
        wi, wo, ours = self.wi[known], self.wo[known], self.ours[known]
        theta_nodes, phi_nodes = self.incidences(at)
        bare = self._adaptive(theta_nodes, phi_nodes, np.zeros((0, 1, 2, 2), np.float32))
        wi, wo = bare.folded(wi, wo)
        phi = directions.spherical_from_vector(wi)[1]
        theta_m, phi_m = directions.spherical_from_vector(wi + wo)
        u = np.sqrt(theta_m * (2 / np.pi))
        v = np.mod((phi_m - (phi if self.isotropic else 0.0)) / (2 * np.pi) + 0.5, 1.0)
        alone = np.zeros(len(u), np.intp), np.ones(len(u))
        n = _STEPS[at.steps]
        corner = Corner.of((n, n), *self.warp.inverse([alone], u, v))
        total = np.zeros(ours.shape)
        for i, j in product((0, 1), (0, 1)):
            there = self.warp.forward(0, (corner.i + i) / (n - 1), (corner.j + j) / (n - 1))
            weight = (corner.x if i else 1 - corner.x) * (corner.y if j else 1 - corner.y)
            for node, share in bare.blend(wi):
                a, b = np.divmod(node, len(theta_nodes))
                incident = theta_nodes[b], phi if self.isotropic else phi_nodes[a]
                total += (weight * share)[:, None] * self._data(*incident, *there)
        theta_i, phi_i = directions.spherical_from_vector(wi)
        found = total * (self._factor(theta_i, phi_i, u, v) / wo[:, 2])[:, None]
        return float(np.quantile(np.abs(found - ours) / ours, 0.95))

    def _data(self, theta: FloatArray, phi: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
        """Samples (M, C): f_r cos(theta_o) / (D / 4 sigma) at incidences and half vectors (M,) each."""
        wi = directions.vector_from_spherical(theta, phi)
        wo = self._outgoing(wi, phi, u, v)
        # Below the horizon it is 0: any other continuation shows above it where light leaves at grazing.
        cosine = np.maximum(wo[:, 2:], 0.0)
        value = self.subject.evaluate(wi, np.concatenate([wo[:, :2], np.abs(wo[:, 2:])], axis=1))[0]
        value = np.where(np.isfinite(value), value, 0.0)
        return value * cosine / self._factor(theta, phi, u, v)[:, None]

    def _outgoing(self, wi: FloatArray, phi: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
        turned = (2 * v - 1) * np.pi + (phi if self.isotropic else 0.0)
        m = directions.vector_from_spherical(u * u * (np.pi / 2), turned)
        return 2 * (wi * m).sum(axis=1)[:, None] * m - wi

    def _factor(self, theta: FloatArray, phi: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
        at = np.sqrt(theta * (2 / np.pi)), np.mod(phi / (2 * np.pi) + 0.5, 1.0)
        return lookup(self.ndf, u, v) / (4 * lookup(self.sigma, *at))

    def _adaptive(self, theta: FloatArray, phi: FloatArray, data: Float32Array) -> Adaptive:
        vndf = np.broadcast_to(self.places, (len(theta) * len(phi), *self.places.shape))
        return Adaptive(theta, phi, self.ndf, self.sigma, vndf, data)

    def sampled(self, at: Resolution) -> tuple[Adaptive, FloatArray, NDArray[np.bool_]]:
        """The samples, (P T, N N) by what a sample is to be weighted when directions are drawn by it, and
        which samples lie above the horizon."""
        theta, phi = self.incidences(at)
        n = _STEPS[at.steps]
        t, s = (c.reshape(-1) for c in np.meshgrid(*2 * [np.linspace(0, 1, n)], indexing="ij"))
        u, v = self.warp.forward(0, s, t)
        incidences = [c.reshape(-1) for c in np.meshgrid(phi, theta, indexing="ij")]
        count = len(self.subject.channels)
        data = np.empty((len(incidences[0]), count, n, n), np.float32)
        drawn, above = np.empty((len(data), n * n)), np.empty((len(data), n * n), bool)
        limit = float(np.finfo(np.float32).max)
        place = lookup(self.places, u, v)
        jacobian = u * np.sin(u * u * (np.pi / 2)) / np.where(place > 0, place, np.inf)
        # Several incidences at a time, as many as are evaluated together.
        step = max(1, _TOGETHER // (n * n))
        for start in range(0, len(data), step):
            part = slice(start, start + step)
            p, a = (np.repeat(c[part], n * n) for c in incidences)
            both = [np.tile(c, len(p) // (n * n)) for c in (u, v)]
            found = np.clip(self._data(a, p, *both), -limit, limit)
            data[part] = found.reshape(-1, n, n, count).transpose(0, 3, 1, 2)
            wi = directions.vector_from_spherical(a, p)
            wo = self._outgoing(wi, p, *both)
            above[part] = (wo[:, 2] > 0).reshape(-1, n * n)
            # f cos as a density over the square: by |d wo / d m| = 4 m.wi and |d m / d(s, t)|.
            to_half = np.linalg.norm(wi + wo, axis=1) / 2
            weight = (self._factor(a, p, *both) * to_half).reshape(-1, n * n)
            drawn[part] = weight * jacobian * above[part]
        return self._adaptive(theta, phi, data), drawn, above


def _nodes(count: int, rows: int) -> tuple[FloatArray, FloatArray]:
    """Half vectors (rows, count, 3) at the nodes of an image over u, and the solid angle there per unit of u
    and v, but for a factor."""
    u = np.linspace(0.0, 1.0, count)
    theta = u * u * (np.pi / 2)
    azimuth = np.linspace(-np.pi, np.pi, rows) if rows > 1 else np.zeros(1)
    return directions.vector_from_spherical(theta, azimuth[:, None]), u * np.sin(theta)
