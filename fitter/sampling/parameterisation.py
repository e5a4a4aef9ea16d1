"""The adaptive parameterisation of EPFL's RGL database: where its samples lie, and what lies between them.

With m the half vector, u(theta, phi) = (sqrt(2 theta / pi), (phi + pi) / (2 pi)) and s(m) the place of m in
the uniform square, by the warp of the visible normals at the incidence,

    f_r cos(theta_o) = data(s(m)) D(u(m)) / (4 sigma(u(wi)))

with every array bilinear, and the warp and the data linear between the stored incidences (J. Dupuy, W.
Jakob 2018, "An adaptive parameterization for efficient material acquisition and rendering", section 4, and
the reader published with it). On isotropic surfaces the azimuth of m counts from that of wi.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.sampling.warp import Warp, lookup, lookup_blend

FloatArray = NDArray[np.float64]

#: So many incident azimuths or fewer, and the surface is isotropic.
ISOTROPIC = 2


@dataclass(frozen=True)
class Adaptive:
    """A measurement in the adaptive parameterisation.

    theta_i (T,), phi_i (P,) : stored incidences, radians, increasing.
    ndf, sigma (H, W) : distribution of normals and projected area of the microsurface over u.
    vndf (P T, H, W) : densities of the visible normals over u.
    data (P T, C, N, N) : the samples. jacobian : whether they are to be multiplied by D / (4 sigma).
    """

    theta_i: FloatArray
    phi_i: FloatArray
    ndf: NDArray[np.floating]
    sigma: NDArray[np.floating]
    vndf: NDArray[np.floating]
    data: NDArray[np.floating]
    jacobian: bool = True

    @property
    def isotropic(self) -> bool:
        return len(self.phi_i) <= ISOTROPIC

    @property
    def folds(self) -> int:
        """How many turned or mirrored copies of the stored incident azimuths make a whole turn.

        2: turned by pi, stored are azimuths in [-pi, 0]; 4: mirrored in x and y, stored are [-pi, -pi/2].
        """
        span = float(self.phi_i[-1] - self.phi_i[0])
        return 1 if self.isotropic or span <= 0 else max(1, round(2 * np.pi / span))

    @cached_property
    def warp(self) -> Warp:
        """Raises ValueError where a density of visible normals has no finite, positive integral."""
        return Warp(self.vndf)

    def nodes(self) -> FloatArray:
        """(P T, 3) unit vectors towards the light, in the order of the samples."""
        phi, theta = np.meshgrid(self.phi_i, self.theta_i, indexing="ij")
        return directions.vector_from_spherical(theta, phi).reshape(-1, 3)

    def samples(self, node: int) -> tuple[FloatArray, FloatArray]:
        """``(wo, factor)`` of one incidence's samples, (N N, 3) and (N N,), rows of the data one by one.

        The factor makes f_r cos(theta_o) of the data. A direction may lie below the horizon.
        """
        rows, columns = self.data.shape[-2:]
        t, s = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
        u, v = self.warp.forward(node, s.reshape(-1), t.reshape(-1))
        theta_i, phi_i = self.theta_i[node % len(self.theta_i)], self.phi_i[node // len(self.theta_i)]
        phi_m = (2 * v - 1) * np.pi + (phi_i if self.isotropic else 0.0)
        m = directions.vector_from_spherical(u * u * (np.pi / 2), phi_m)
        wi = directions.vector_from_spherical(theta_i, phi_i)
        wo = 2 * (m @ wi)[:, None] * m - wi
        return wo, self._factor(np.full(len(u), theta_i), np.full(len(u), phi_i), u, v)

    def evaluate(self, wi: FloatArray, wo: FloatArray) -> FloatArray:
        """f_r cos(theta_o) (M, C) in 1/sr between the samples, of directions (M, 3) above the horizon.

        Beyond the stored incidences those at the edge stand.
        """
        wi, wo = self.folded(wi, wo)
        theta_i, phi_i = directions.spherical_from_vector(wi)
        theta_m, phi_m = directions.spherical_from_vector(wi + wo)
        u = np.sqrt(theta_m * (2 / np.pi))
        v = np.mod((phi_m - (phi_i if self.isotropic else 0.0)) / (2 * np.pi) + 0.5, 1.0)
        blend = self.blend(wi)
        s, t = self.warp.inverse(blend, u, v)
        return lookup_blend(self.data, blend, s, t) * self._factor(theta_i, phi_i, u, v)[:, None]

    def blend(self, wi: FloatArray) -> list[tuple[NDArray[np.intp], FloatArray]]:
        """Stored incidences by number and their weights, each (M,), of incidences (M, 3) that are folded."""
        theta_i, phi_i = directions.spherical_from_vector(wi)
        low_phi, share_phi = _between(self.phi_i, phi_i)
        low_theta, share_theta = _between(self.theta_i, theta_i)
        blend: list[tuple[NDArray[np.intp], FloatArray]] = []
        for a, b in product(range(min(len(self.phi_i), 2)), range(min(len(self.theta_i), 2))):
            weight = (share_phi if a else 1 - share_phi) * (share_theta if b else 1 - share_theta)
            blend.append(((low_phi + a) * len(self.theta_i) + low_theta + b, weight))
        return blend

    def _factor(self, theta_i: FloatArray, phi_i: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
        if not self.jacobian:
            return np.ones(len(u))
        at = np.sqrt(theta_i * (2 / np.pi)), np.mod(phi_i / (2 * np.pi) + 0.5, 1.0)
        return lookup(self.ndf, u, v) / (4 * lookup(self.sigma, *at))

    def folded(self, wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Both (M, 3) turned or mirrored so that wi is among the stored azimuths."""
        if self.folds not in (2, 4):
            return wi, wo
        y = np.where(wi[:, 1] > 0, -1.0, 1.0)
        x = y if self.folds == 2 else np.where(wi[:, 0] > 0, -1.0, 1.0)
        sign = np.stack([x, y, np.ones(len(wi))], axis=1)
        return wi * sign, wo * sign


def _between(nodes: FloatArray, x: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """The node (M,) below each of x, and how far x is on the way to the next, in [0, 1]."""
    if len(nodes) == 1:
        return np.zeros(len(x), np.intp), np.zeros(len(x))
    low = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    share = np.clip((x - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)
    return low.astype(np.intp), share
