"""Periodic triangulated height fields and exact ray intersection with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Rays per vectorised block: its working arrays (about 20 x 8 bytes a ray) then stay in the cache.
BLOCK = 16_384
#: Compact a block when fewer than this share of its rays are still under way.
COMPACT_BELOW = 0.75
#: Least size of a direction's x and y components.
VERTICAL = 1e-12


def normals(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Standard normal numbers by Box and Muller from ``rng.random``.

    NumPy promises the stream of raw uniform numbers of a bit generator, not the one of
    ``standard_normal``, and these tables must come out the same for years.
    """
    radius = np.sqrt(-2.0 * np.log1p(-rng.random(shape)))
    return radius * np.cos(2.0 * np.pi * rng.random(shape))


@dataclass(frozen=True)
class Hits:
    """Where rays met the surface. ``hit`` (N,) bool; ``position`` (3, N) and ``normal`` (3, N) are
    meaningful where ``hit``; the normal is that of the facet, unit length, pointing up."""

    hit: NDArray[np.bool_]
    position: FloatArray
    normal: FloatArray


class HeightField:
    """Periodic n x n height field; each unit cell is two triangles cut along its (0,0)-(1,1) diagonal.

    Parameters
    ----------
    height : (n, n) float64 heights at the vertices, in units of the cell's side; ``height[i, j]`` is at
        x = i, y = j. n must be a power of two (periodic indices are then a bit mask).
    """

    def __init__(self, height: FloatArray) -> None:
        n = height.shape[0]
        if height.shape != (n, n) or n & (n - 1):
            raise ValueError(f"height has shape {height.shape}, expected (n, n) with n a power of two")
        self.size = n
        self.top = float(height.max())
        self._z = np.ascontiguousarray(height, np.float64).reshape(-1)

    @classmethod
    def gaussian(
        cls,
        size: int,
        correlation: tuple[float, float],
        rms_slope: float,
        rng: np.random.Generator,
        skew: float = 0.0,
    ) -> HeightField:
        """Gaussian-correlated field, autocorrelation exp(-(x/Tx)^2 - (y/Ty)^2).

        Parameters
        ----------
        correlation : (Tx, Ty) correlation lengths in cells.
        rms_slope : root mean square of the facets' slope dz/dy; along x it comes out Ty/Tx times that.
        skew : the heights h (in units of their standard deviation) are mapped to (exp(skew h) - 1) / skew
            before scaling. Slopes are then a Gaussian times a log-normal factor, with heavier tails than
            any Gaussian surface has; negative values flatten the peaks and sharpen the valleys, as wear
            and levelling do. 0 leaves the field Gaussian.
        """
        k = 2.0 * np.pi * np.fft.fftfreq(size)
        # The square root of the power spectrum of exp(-x^2/T^2) is proportional to exp(-k^2 T^2 / 8).
        filters = [np.exp(-(k * t) ** 2 / 8.0) for t in correlation]
        noise = np.fft.fft2(normals(rng, (size, size)))
        height = np.fft.ifft2(noise * filters[0][:, None] * filters[1][None, :]).real
        height = (height - height.mean()) / height.std()
        if skew:
            height = np.expm1(skew * height) / skew
        slope = np.sqrt(np.mean((np.roll(height, -1, axis=1) - height) ** 2))
        return cls(height * (rms_slope / slope))

    @classmethod
    def flat(cls, size: int = 8) -> HeightField:
        """The plane z = 0."""
        return cls(np.zeros((size, size)))

    def rms_slopes(self) -> tuple[float, float]:
        """Root mean square slopes of the facets along x and y."""
        z = self._z.reshape(self.size, self.size)
        dx, dy = np.roll(z, -1, axis=0) - z, np.roll(z, -1, axis=1) - z
        return float(np.sqrt(np.mean(dx**2))), float(np.sqrt(np.mean(dy**2)))

    def height_at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Height of the triangulated surface at points (N,)."""
        i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        u, v = x - i, y - j
        lower = u >= v
        corner = self._at(i, j)
        middle = self._at(i + lower, j + ~lower)
        far = self._at(i + 1, j + 1)
        return corner + np.maximum(u, v) * (middle - corner) + np.minimum(u, v) * (far - middle)

    def intersect(self, origin: FloatArray, direction: FloatArray, gap: FloatArray) -> Hits:
        """First intersection of rays with the surface.

        Parameters
        ----------
        origin, direction : (3, N); the length of a direction is irrelevant.
        gap : (N,) height of each origin above the surface, exactly 0 for rays that leave a facet.

        The ray is cut by the three families of lines that bound the triangles (x, y and x - y integer).
        Between two cuts both ray and surface are straight, so that the sign of the gap at the cuts
        decides, and the root of its linear interpolant is the exact intersection.
        """
        n = origin.shape[1]
        hit = np.zeros(n, bool)
        position, normal = np.zeros((3, n)), np.zeros((3, n))
        for start in range(0, n, BLOCK):
            part = slice(start, min(start + BLOCK, n))
            rays, t, middle = self._march(origin[:, part], direction[:, part], gap[part])
            rays += start
            hit[rays] = True
            o, d = origin[:, rays], direction[:, rays]
            position[:, rays] = o + t * d
            normal[:, rays] = self._normal(o[0] + middle * d[0], o[1] + middle * d[1])
        return Hits(hit, position, normal)

    def _march(
        self, o: FloatArray, d: FloatArray, gap: FloatArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """(ray indices, ray parameter of the hit, ray parameter in the middle of its segment)."""
        # A vertical ray cuts no line: lean it by less than rounding over any height there is.
        d = np.stack([*np.where(np.abs(d[:2]) < VERTICAL, VERTICAL, d[:2]), d[2]])
        with np.errstate(divide="ignore", invalid="ignore"):
            starts = [_first_cut(o[0], d[0]), _first_cut(o[1], d[1]), _first_cut(o[0] - o[1], d[0] - d[1])]
        # One row per state variable, so that compaction is one indexing operation.
        state = np.stack(
            [*o, *d, np.zeros_like(gap), gap, *(row for triple in starts for row in triple)]
        )
        ray = np.arange(o.shape[1])
        found: list[tuple[IntArray, FloatArray, FloatArray]] = []
        active = np.ones(len(ray), bool)
        while len(ray):
            ox, oy, oz, dx, dy, dz, t0, g0, tx, sx, _, ty, sy, _, td, sd, kd = state
            t1 = np.minimum(np.minimum(tx, ty), td)
            on_x, on_y = tx == t1, ty == t1
            x, y = ox + t1 * dx, oy + t1 * dy
            # On its own family of lines a coordinate is an integer but for rounding.
            x = np.where(on_x, np.rint(x), x)
            i = np.floor(x)
            j = np.where(on_x | on_y, np.floor(np.where(on_y, np.rint(y), y)), i - kd)
            along = np.where(on_x, y - j, x - i)
            zi, zj = i.astype(np.int64), j.astype(np.int64)
            near, far = self._at(zi, zj), self._at(zi + ~on_x, zj + ~(on_y & ~on_x))
            z = oz + t1 * dz
            g1 = z - (near + along * (far - near))
            through = active & (g1 < 0)
            if through.any():
                w = np.flatnonzero(through)
                a, b = t0[w], t1[w]
                t = a + (b - a) * (g0[w] / (g0[w] - g1[w]))
                found.append((ray[w], t, 0.5 * (a + b)))
            active &= ~through & ~((dz >= 0) & (z > self.top))
            on_d = ~(on_x | on_y)
            # Without a step (a ray along the lines) the next cut stays at infinity.
            tx += np.where(on_x, sx, 0.0)
            ty += np.where(on_y & ~on_x, sy, 0.0)
            td += np.where(on_d, sd, 0.0)
            kd += np.where(on_d, np.sign(dx - dy), 0.0)
            t0[:], g0[:] = t1, g1
            if active.mean() < COMPACT_BELOW:
                state, ray = state[:, active], ray[active]
                active = np.ones(len(ray), bool)
        if not found:
            return np.empty(0, np.int64), np.empty(0), np.empty(0)
        rays, t, middle = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return rays, t, middle

    def _normal(self, x: FloatArray, y: FloatArray) -> FloatArray:
        i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        lower = (x - i) >= (y - j)
        corner, far = self._at(i, j), self._at(i + 1, j + 1)
        middle = self._at(i + lower, j + ~lower)
        slope_x = np.where(lower, middle - corner, far - middle)
        slope_y = np.where(lower, far - middle, middle - corner)
        length = np.sqrt(slope_x**2 + slope_y**2 + 1.0)
        return np.stack([-slope_x / length, -slope_y / length, 1.0 / length])

    def _at(self, i: IntArray, j: IntArray) -> FloatArray:
        mask = self.size - 1
        return self._z.take((i & mask) * self.size + (j & mask))


def _first_cut(o: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ray parameter of the first integer line ahead, the step to the next one, and that line's number."""
    forward = d > 0
    line = np.where(forward, np.floor(o) + 1.0, np.ceil(o) - 1.0)
    step = np.where(d != 0, np.abs(1.0 / d), 0.0)
    return np.where(d != 0, (line - o) / d, np.inf), step, line
