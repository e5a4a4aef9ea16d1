"""The interpolant of a table in an adaptive parameterisation: the file's own, by its own warp.

Its samples are denser where the surface reflects much, and the file says what lies between them
(:mod:`fitter.sampling.parameterisation`): f_r cos(theta_o) = data(s(m)) D(u(m)) / (4 sigma(u(wi))), with m
the half vector.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter import directions
from fitter.metadata import Quantity
from fitter.parts import in_parts
from fitter.sampling.alias import AliasTable
from fitter.sampling.cells import ChartSlice
from fitter.sampling.curvature import gain_of_image
from fitter.sampling.drawing import Kernel, in_lines
from fitter.sampling.envelope import JointEnvelope, Method, no_inversion
from fitter.sampling.interpolant import Slice, in_chunks, pairs
from fitter.sampling.majorants import AT_ONCE, MANY, ROUNDING
from fitter.sampling.maxima import packed
from fitter.sampling.parameterisation import Adaptive
from fitter.sampling.warp import Corner, looked_up, lookup

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_CHUNK = 1 << 14
_KIND = "a table in an adaptive parameterisation"
#: Rounding of places in the uniform square.
SLACK = 1e-9
# Columns of the cells to begin with. The rows are those of the warp, cut to this many at least: cells are
# then narrow enough for a short series of their azimuths' sines.
_COLUMNS, _ROWS = 32, 24


@dataclass(frozen=True)
class AdaptiveInterpolant:
    """``quantity`` is what the file's numbers are; NaN among its data was not measured."""

    adaptive: Adaptive
    quantity: Quantity
    in_plane: bool = False

    def __getstate__(self) -> dict[str, Any]:
        # The warp is several times the data, and computed again where it is needed.
        return {"adaptive": replace(self.adaptive), "quantity": self.quantity, "in_plane": False}

    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> tuple[FloatArray, BoolArray]:
        """``(values, extrapolated)``, (M, C) in 1/sr and (M,), of direction pairs (M, 3) or (3,).

        Where nothing was measured (NaN), 0.
        """
        return in_chunks(self._evaluate, wi, wo, self.adaptive.data.shape[1], _CHUNK)

    def _evaluate(self, wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, BoolArray]:
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        values = np.zeros((len(wi), self.adaptive.data.shape[1]))
        values[above] = self.adaptive.evaluate(wi[above], wo[above])
        if self.quantity == "ccbrdf":
            values[above] /= wo[above, 2:]
        elif self.quantity == "reflectance_factor":
            values /= np.pi
        missing = ~np.isfinite(values).all(axis=1)
        values[missing] = 0.0
        return values, ~above | missing | self._outside(wi)

    def _outside(self, wi: FloatArray) -> BoolArray:
        theta, _ = directions.spherical_from_vector(wi)
        nodes = self.adaptive.theta_i
        return (theta < nodes[0] - 1e-6) | (theta > nodes[-1] + 1e-6)

    def slice(self, wi: ArrayLike) -> Slice:
        """The interpolant at the one incidence ``wi`` (3,)."""
        w = pairs(wi, wi)[0][:1]
        return ChartSlice(
            w[0], bool(self._outside(w)[0]) or bool(w[0, 2] <= 0), _KIND,
            lambda part, weights: AdaptiveField(self, part, weights),
        )  # fmt: skip

    def joint(
        self, weights: FloatArray, acceptance: float, cells: int, method: Method | None
    ) -> JointEnvelope:
        """What pairs (wi, wo) are drawn from."""
        from fitter.sampling.joint_adaptive import AdaptiveJoint

        if method == "inversion":
            raise no_inversion(_KIND)
        return AdaptiveJoint(self, weights, acceptance, cells)


class AdaptiveField:
    """The chart is (u, v) of the half vector m: theta_m = u^2 pi/2, azimuth (2 v - 1) pi; its measure du dv.

    With dwo = 4 (wi.m) dw_m and dw_m = sin(theta_m) (pi u du) (2 pi dv) the field is data(s) D (wi.m) 2 pi^2
    u sin(theta_m) / sigma.
    """

    def __init__(self, table: AdaptiveInterpolant, part: ChartSlice, weights: FloatArray) -> None:
        adaptive, self._quantity = table.adaptive, table.quantity
        self.extrapolated = part.extrapolated
        self._wi = part.wi
        # The file's copies of the surface: drawn on the stored one, turned or mirrored back.
        folded, _ = adaptive.folded(part.wi[None], part.wi[None])
        self._sign = np.where(folded[0] * part.wi < 0, -1.0, 1.0)
        self._wi = folded[0]
        blend = adaptive.blend(folded)
        theta_i, phi_i = (float(a[0]) for a in directions.spherical_from_vector(folded))
        self._turn = float(phi_i) if adaptive.isotropic else 0.0
        share = [(int(node[0]), float(weight[0])) for node, weight in blend]
        self._warp = adaptive.warp.blended(share)
        self._packed = self._warp.packed
        raw = sum(w * adaptive.data[k].astype(np.float64) for k, w in share)
        clamped = sum(w * np.maximum(adaptive.data[k].astype(np.float64), 0.0) for k, w in share)
        self._channels = np.asarray(clamped)
        self._clamped, self._raw = (
            np.tensordot(weights, some, 1) for some in (self._channels, np.asarray(raw))
        )
        self.clamps = bool(np.any(self._clamped != self._raw))
        self._ndf = np.asarray(adaptive.ndf, np.float64) if adaptive.jacobian else np.full((2, 2), 4.0)
        at = np.array([np.sqrt(theta_i * (2 / np.pi))]), np.array([np.mod(phi_i / (2 * np.pi) + 0.5, 1.0)])
        self._sigma = float(lookup(adaptive.sigma, *at)[0]) if adaptive.jacobian else 1.0
        self._most = packed(np.nan_to_num(self._clamped, nan=0.0)), packed(self._ndf)

    def edges(self) -> tuple[FloatArray, FloatArray]:
        rows = self._warp.shape[0] - 1
        return np.linspace(0, 1, _COLUMNS + 1), np.linspace(0, 1, rows * -(-_ROWS // rows) + 1)

    def measures(self, cells: FloatArray) -> FloatArray:
        return (cells[:, 1] - cells[:, 0]) * (cells[:, 3] - cells[:, 2])

    def measure(self, a: FloatArray, b: FloatArray) -> FloatArray:
        return np.ones_like(a)

    def tall(self, cells: FloatArray) -> BoolArray:
        """The longer side as seen on the sphere of half vectors."""
        u0, u1, v0, v1 = cells.T
        return np.pi * u1 * (u1 - u0) >= np.sin(0.5 * np.pi * u1**2) * 2 * np.pi * (v1 - v0)

    def kernel(self, alias: AliasTable, cells: FloatArray, majorant: FloatArray, integral: float) -> Kernel:
        from fitter.kernels import adaptive

        u0, u1, v0, v1 = cells.T
        azimuth = (v0 + v1 - 1) * np.pi + self._turn
        rows = in_lines([u0, u1 - u0, v0, v1 - v0, majorant, np.cos(azimuth), np.sin(azimuth)], 8)
        channels = self._channels.reshape(len(self._channels), -1).T.reshape(-1)
        clamped, lobes = self._clamped.reshape(-1), self._ndf.reshape(-1)
        return Kernel(
            partial(
                adaptive.fill, *alias.boxes, rows, *self._packed, clamped, self._clamped.shape, channels,
                lobes, self._ndf.shape, self._factor, self._quantity == "ccbrdf", self._incidence,
                tuple(map(float, self._sign)), integral,
            )
        )  # fmt: skip

    def integrals(
        self, cells: FloatArray, x: FloatArray, share: FloatArray, *, clamped: bool = True
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        from fitter.kernels.adaptive_cells import integrals

        data = self._clamped if clamped else self._raw
        found, known = np.empty(len(cells)), np.empty(len(cells), np.int64)

        def some(part: slice) -> None:
            integrals(
                cells[part], x, share, *self._packed, data.reshape(-1), data.shape,
                self._ndf.reshape(-1), self._ndf.shape, self._factor, self._quantity == "ccbrdf",
                self._incidence, float(self._turn), found[part], known[part],
            )  # fmt: skip

        in_parts(some, len(cells), AT_ONCE, MANY)
        return found, known

    @property
    def _incidence(self) -> tuple[float, float, float]:
        return float(self._wi[0]), float(self._wi[1]), float(self._wi[2])

    @property
    def _factor(self) -> float:
        """What f+, or f+ cos(theta_o), is of the data times D."""
        return 1 / (4 * self._sigma * (np.pi if self._quantity == "reflectance_factor" else 1.0))

    def _half(self, a: FloatArray, b: FloatArray) -> FloatArray:
        return directions.vector_from_spherical(a * a * (np.pi / 2), (2 * b - 1) * np.pi + self._turn)

    def _square(self, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self._warp.inverse_of_one(Corner.of(self._warp.shape, a, b))

    def _placed(self, a: FloatArray, b: FloatArray) -> tuple[Corner, Corner]:
        """Where points lie on the images of the data, and of D."""
        return Corner.of(self._clamped.shape, *self._square(a, b)), Corner.of(self._ndf.shape, a, b)

    def _factored(self, data: FloatArray, place: tuple[Corner, Corner]) -> FloatArray:
        """(M,) what the file's numbers are of: f_r, pi f_r as f_r, or f_r cos(theta_o)."""
        value = looked_up(data, place[0])
        value *= looked_up(self._ndf, place[1])
        value *= self._factor
        return value

    def field(self, a: FloatArray, b: FloatArray, *, clamped: bool = True) -> FloatArray:
        m = self._half(a, b)
        along = m @ self._wi
        height = 2 * along * m[:, 2] - self._wi[2]
        value = self._factored(self._clamped if clamped else self._raw, self._placed(a, b))
        value *= along * (8 * np.pi**2) * a * np.sin(a * a * (np.pi / 2))
        if self._quantity != "ccbrdf":
            value *= height
        value[~((height > 0) & (along > 0))] = np.nan
        return value

    def bound(self, cells: FloatArray) -> FloatArray:
        """Product of the bounds of the factors.

        1. The data. t, the second coordinate of s, depends on v alone and grows with it. The first grows
           with u; at fixed u it is ((1 - x) p + x q)/((1 - x) P + x Q) with x linear in v between two rows of
           the warp, a fraction of linear functions without a pole, so monotone in v there. A function that is
           monotone in each variable takes its extremes over a rectangle at corners: they give a rectangle
           that holds s. Cells begin as the warp's rows and are only ever halved.
        2. D: on the cell itself.
        3. wi.m is the cosine of an angle that is at least the centre's less the cell's radius, which is as in
           :class:`fitter.sampling.half_difference.HalfDifferenceField`.
        4. u sin(theta_m) grows with u.
        """
        from fitter.kernels.adaptive_cells import bounds

        found = np.empty(len(cells))
        data, lobe = self._most
        factor = 2 * np.pi**2 / self._sigma

        def some(part: slice) -> None:
            bounds(
                cells[part], *self._packed, *data, *lobe, factor, self._incidence, self._turn, SLACK,
                found[part],
            )  # fmt: skip

        in_parts(some, len(cells), AT_ONCE, MANY)
        return found * (1 + ROUNDING)

    def solid_angle(self, a: FloatArray, b: FloatArray) -> FloatArray:
        along = np.maximum(self._half(a, b) @ self._wi, 0.0)
        return 8 * np.pi**2 * along * a * np.sin(a * a * (np.pi / 2))

    def directions(self, a: FloatArray, b: FloatArray) -> FloatArray:
        m = self._half(a, b)
        return (2 * (m @ self._wi)[:, None] * m - self._wi) * self._sign

    def coordinates(self, wo: FloatArray) -> tuple[FloatArray, FloatArray]:
        theta, phi = directions.spherical_from_vector(wo * self._sign + self._wi)
        return np.sqrt(theta * (2 / np.pi)), np.mod((phi - self._turn) / (2 * np.pi) + 0.5, 1.0)

    def gain(self, a: FloatArray, b: FloatArray, weight: FloatArray) -> float:
        place = self._placed(a, b)
        data, ndf = looked_up(self._clamped, place[0]), looked_up(self._ndf, place[1])
        # Of the data and of D: the field is their product, times what is not interpolated.
        other = data * ndf
        other = weight * np.nan_to_num(self.field(a, b)) / np.where(other > 0, other, np.inf)
        return gain_of_image(self._clamped, place[0], other * ndf) + gain_of_image(
            self._ndf, place[1], other * data
        )

    def place(self, a: FloatArray, b: FloatArray) -> tuple[NDArray[Any], ...]:
        return self._flat(self._placed(a, b), self.directions(a, b)[:, 2])

    def _flat(self, place: tuple[Corner, Corner], height: FloatArray) -> tuple[NDArray[Any], ...]:
        return (*(column for at in place for column in (at.i, at.j, at.x, at.y)), height)

    def channels(self, place: tuple[NDArray[Any], ...]) -> FloatArray:
        at, height = (Corner(*place[:4]), Corner(*place[4:8])), place[8]
        found = np.stack([self._factored(channel, at) for channel in self._channels], axis=1)
        if self._quantity == "ccbrdf":
            found /= np.where(height > 0, height, np.inf)[:, None]
        found[height <= 0] = np.nan
        return found


def nearest_cosine(cells: FloatArray, turn: float, wi: FloatArray, spread: FloatArray | float) -> FloatArray:
    """(K,) the largest wi.m, not below 0, for half vectors m of cells (K, 4) = u0, u1, v0, v1 and incidences
    within ``spread`` (radians) of ``wi`` (1 or K, 3). turn : what m's azimuth counts from."""
    u0, u1, v0, v1 = cells.T
    theta0, theta1 = u0 * u0 * (np.pi / 2), u1 * u1 * (np.pi / 2)
    theta = 0.5 * (theta0 + theta1)
    centre = directions.vector_from_spherical(theta, (v0 + v1 - 1) * np.pi + turn)
    across = np.sin(theta) * np.sin(theta1) * np.sin(0.5 * np.pi * (v1 - v0)) ** 2
    radius = 2 * np.arcsin(np.sqrt(np.minimum(np.sin(0.25 * (theta1 - theta0)) ** 2 + across, 1.0)))
    angle = np.arctan2(np.linalg.norm(np.cross(centre, wi), axis=1), (centre * wi).sum(axis=1))
    return np.maximum(np.cos(np.maximum(angle - radius - spread - 1e-12, 0.0)), 0.0)
