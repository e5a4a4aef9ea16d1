"""The six stored components of a pair of directions, and what every model derives from them."""

from __future__ import annotations

from typing import NamedTuple

from mpmath import mp, mpf


class Half(NamedTuple):
    """A half vector that is not normalised; ``squared`` = |H|^2."""

    x: mpf
    y: mpf
    z: mpf

    @property
    def squared(self) -> mpf:
        return self.x**2 + self.y**2 + self.z**2

    @property
    def tan2(self) -> mpf:
        """tan^2 of its angle with the normal."""
        return (self.x**2 + self.y**2) / self.z**2

    def turned(self, psi: mpf) -> Half:
        """Its components in the frame turned by psi about the normal."""
        return Half(*turned(self.x, self.y, psi), self.z)


class Pair(NamedTuple):
    """wi = (ix, iy, iz) and wo = (ox, oy, oz) as stored, not renormalised."""

    ix: mpf
    iy: mpf
    iz: mpf
    ox: mpf
    oy: mpf
    oz: mpf

    @property
    def above(self) -> bool:
        return self.iz > 0 and self.oz > 0

    @property
    def half(self) -> Half:
        return Half(self.ix + self.ox, self.iy + self.oy, self.iz + self.oz)

    @property
    def across(self) -> mpf:
        """ix ox + iy oy."""
        return self.ix * self.ox + self.iy * self.oy

    @property
    def cos_d(self) -> mpf:
        """Cosine of the angle between either direction and the half vector, |H|/2."""
        return mp.sqrt(self.half.squared) / 2

    @property
    def sin2_d(self) -> mpf:
        """sin^2 of that angle, |wi - wo|^2/4."""
        return ((self.ix - self.ox) ** 2 + (self.iy - self.oy) ** 2 + (self.iz - self.oz) ** 2) / 4

    @property
    def schlick(self) -> mpf:
        """Schlick's weight (1 - c)^5 with 1 - c = s2/(1 + c)."""
        return (self.sin2_d / (1 + self.cos_d)) ** 5

    def turned(self, psi: mpf) -> Pair:
        """Both directions in the frame turned by psi about the normal."""
        return Pair(*turned(self.ix, self.iy, psi), self.iz, *turned(self.ox, self.oy, psi), self.oz)


def turned(x: mpf, y: mpf, psi: mpf) -> tuple[mpf, mpf]:
    """x and y in the frame turned by psi about the normal."""
    if not psi:
        return x, y
    c, s = mp.cos(psi), mp.sin(psi)
    return x * c + y * s, y * c - x * s
