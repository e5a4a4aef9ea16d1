"""Samples that physics makes equal: reciprocal pairs, and turns of an isotropic surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.quality.finding import Finding, counted, degrees, graded, not_judged, percent
from fitter.quality.measured import AT_NORMAL, Measured

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

#: Both directions together may miss their partner by this angle (radians).
WITHIN = float(np.deg2rad(0.25))
#: Relative rms difference beyond the noise from which on it is said, and from which on it is a warning.
DIFFERENT, VERY_DIFFERENT = 0.03, 0.10
#: Fewer pairs than this say nothing about a table.
FEWEST = 10
#: Incident azimuths closer than this (radians) are one.
SAME_AZIMUTH = float(np.deg2rad(1.0))
#: Sums of two values below this part of the channel's median are left out: a relative difference of noise.
_NEAR_ZERO = 0.01
_TARGETS = 50_000


@dataclass(frozen=True)
class Compared:
    """Relative differences 2 (a - b) / (|a| + |b|) of samples that should be equal.

    rms, largest : over pairs and channels; typical : median of the absolute differences over 0.6745;
    where : (2, 3) directions of the pair with the largest difference.
    """

    pairs: int
    rms: float
    typical: float
    largest: float
    where: FloatArray

    def numbers(self) -> dict[str, Any]:
        theta, phi = directions.spherical_from_vector(self.where)
        return {
            "pairs": self.pairs, "relative_rms": self.rms, "relative_typical": self.typical,
            "relative_largest": self.largest,
            "largest_at_deg": {
                "theta_i": float(np.rad2deg(theta[0])), "phi_i": float(np.rad2deg(phi[0])),
                "theta_o": float(np.rad2deg(theta[1])), "phi_o": float(np.rad2deg(phi[1])),
            },
            "within_deg": float(np.rad2deg(WITHIN)),
        }  # fmt: skip

    @property
    def place(self) -> str:
        theta, _ = directions.spherical_from_vector(self.where)
        return f"theta_i = {degrees(float(theta[0]))}, theta_o = {degrees(float(theta[1]))}"


def compare(measured: Measured, position: IndexArray, partner: IndexArray) -> Compared | None:
    """Of samples ``position`` in ``measured.rows`` with the rows ``partner`` of the table."""
    if not len(position):
        return None
    one, other = measured.value[position], measured.table.value[partner]
    size = 0.5 * (np.abs(one) + np.abs(other))
    usable = size > _NEAR_ZERO * np.where(measured.typical > 0, measured.typical, np.inf)
    if not usable.any():
        return None
    difference = np.where(usable, (one - other) / np.where(usable, size, 1.0), 0.0)
    found = np.abs(difference[usable])
    at = int(np.argmax(np.abs(difference).max(axis=1)))
    return Compared(
        len(position), float(np.sqrt(np.mean(found**2))), float(np.median(found)) / 0.6745,
        float(found.max()), np.stack([measured.wi[position[at]], measured.wo[position[at]]]),
    )  # fmt: skip


def reciprocity(measured: Measured, noise: float | None) -> Finding:
    """Helmholtz reciprocity f(wi, wo) = f(wo, wi) where both were measured.

    noise : relative standard deviation of one sample; the square of sqrt(2) noise is taken off the rms.
    """
    name = "reciprocity"
    grid = measured.table.grid
    if grid is not None and grid.system == "half_difference":
        period = grid.periodic.get("phi_d")
        if (period is not None and period < 1.5 * np.pi) or np.ptp(grid.axes["phi_d"]) < 1.01 * np.pi:
            return not_judged(
                name, "The table holds half a turn of phi_d only, so that reciprocity is built in and can't "
                "be tested.", pairs=0,
            )  # fmt: skip
    position = measured.draw(_TARGETS)
    wi, wo = measured.wi[position], measured.wo[position]
    possible = wo[:, 2] > 0
    position, wi, wo = position[possible], wi[possible], wo[possible]
    row, distance = measured.nearest(wo, wi)
    # A sample that is its own partner (theta_i = theta_o of an isotropic surface) tests nothing.
    own = measured.features[position] - _swapped(measured, wi, wo)
    good = (distance <= WITHIN) & (np.linalg.norm(own, axis=1) > 2 * WITHIN)
    position, row = position[good], row[good]
    first = np.sort(np.stack([measured.rows[position], row], axis=1), axis=1)
    _, once = np.unique(first, axis=0, return_index=True)
    found = compare(measured, position[once], row[once])
    if found is None or found.pairs < FEWEST:
        count = 0 if found is None else found.pairs
        there = "No" if not count else f"Only {count}"
        return not_judged(
            name, f"{there} reciprocal pairs of samples lie within {degrees(WITHIN)} of each other: "
            "reciprocity can't be judged.", pairs=count,
        )  # fmt: skip
    excess = _excess(found.rms, noise)
    sentence = (
        f"{counted(found.pairs, 'reciprocal pair differs', 'reciprocal pairs differ')} by "
        f"{percent(found.rms)} (relative rms), at most by {percent(found.largest)} at {found.place}"
        f"{_compared_with(noise)}."
    )
    numbers = {**found.numbers(), "relative_rms_beyond_noise": excess}
    return Finding(name, graded(excess, DIFFERENT, VERY_DIFFERENT), sentence, numbers)


def _swapped(measured: Measured, wi: FloatArray, wo: FloatArray) -> FloatArray:
    from fitter.quality.measured import features

    return features(wo, wi, isotropic=measured.isotropic)


def isotropy(measured: Measured, noise: float | None) -> Finding:
    """Samples against those of another incident azimuth that an isotropic surface could not tell from them."""
    name = "isotropy"
    grid = measured.table.grid
    tilted = np.flatnonzero(np.hypot(measured.wi[:, 0], measured.wi[:, 1]) > AT_NORMAL)
    _, phi = directions.spherical_from_vector(measured.wi[tilted])
    azimuths = _distinct(np.mod(phi, 2 * np.pi))
    if len(azimuths) < 2 or (grid is not None and grid.system != "spherical"):
        return not_judged(
            name, "The sample was measured at one incident azimuth only: whether it is isotropic is not known "
            "from this table.", azimuths=len(azimuths), pairs=0,
        )  # fmt: skip
    rng = np.random.default_rng(measured.seed + 2)
    position = tilted[rng.permutation(len(tilted))[: _TARGETS // 2]]
    positions: list[IndexArray] = []
    rows: list[IndexArray] = []
    # Each sample is turned to two of the other azimuths.
    for _ in range(min(2, len(azimuths) - 1)):
        _, own = directions.spherical_from_vector(measured.wi[position])
        nearest = np.argmin(np.abs(_wrapped(azimuths[None, :] - own[:, None])), axis=1)
        other = (nearest + rng.integers(1, len(azimuths), len(position))) % len(azimuths)
        turn = azimuths[other] - azimuths[nearest]
        row, distance = measured.nearest(
            _turn(measured.wi[position], turn), _turn(measured.wo[position], turn), isotropic=False
        )
        good = distance <= WITHIN
        positions.append(position[good])
        rows.append(row[good])
    found = compare(measured, np.concatenate(positions), np.concatenate(rows))
    numbers: dict[str, Any] = {"azimuths": len(azimuths), "pairs": 0}
    if found is None or found.pairs < FEWEST:
        return not_judged(
            name, f"{len(azimuths)} incident azimuths were measured, but hardly any samples differ by a turn of "
            "the surface only: isotropy can't be judged.", **numbers,
        )  # fmt: skip
    excess = _excess(found.rms, noise)
    numbers |= {**found.numbers(), "relative_rms_beyond_noise": excess}
    said = (
        f"Turning the sample about its normal changes {found.pairs:,} values by {percent(found.rms)} "
        f"(relative rms over {len(azimuths)} incident azimuths{_compared_with(noise)})"
    )
    if measured.isotropic:
        verdict = graded(excess, DIFFERENT, VERY_DIFFERENT)
        end = ", as of an isotropic surface" if verdict == "ok" else ", yet the table is taken for isotropic"
        return Finding(name, verdict, f"{said}{end}.", numbers)
    end = ": it is isotropic as far as this shows" if excess <= DIFFERENT else ": it is anisotropic"
    return Finding(name, "ok", f"{said}{end}.", numbers)


def _excess(rms: float, noise: float | None) -> float:
    """What of a difference of two samples their noise does not explain."""
    return float(np.sqrt(max(rms**2 - 2.0 * (noise or 0.0) ** 2, 0.0)))


def _compared_with(noise: float | None) -> str:
    return "" if noise is None else f"; noise alone gives {percent(np.sqrt(2.0) * noise)}"


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.mod(angle + np.pi, 2 * np.pi) - np.pi


def _distinct(phi: FloatArray) -> FloatArray:
    """Azimuths in [0, 2 pi) that differ by more than ``SAME_AZIMUTH``, at most a turn's worth."""
    if not len(phi):
        return phi
    found = np.unique(np.round(phi / SAME_AZIMUTH))
    turn = round(2 * np.pi / SAME_AZIMUTH)
    return np.unique(np.mod(found, turn)) * SAME_AZIMUTH


def _turn(w: FloatArray, by: FloatArray) -> FloatArray:
    """Directions (n, 3) turned about the normal by angles (n,)."""
    c, s = np.cos(by), np.sin(by)
    return np.stack([c * w[:, 0] - s * w[:, 1], s * w[:, 0] + c * w[:, 1], w[:, 2]], axis=1)
