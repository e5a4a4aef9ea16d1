"""Samples that physics makes equal: reciprocal pairs, and turns of an isotropic surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.quality.finding import Finding, degrees, graded, not_judged, percent
from fitter.quality.measured import AT_NORMAL, Measured, features
from fitter.quality.noise import MAD, Noise

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

    rms, largest : over pairs and channels; typical : the same from their median;
    noise : rms that the noise of two samples explains; where : (2, 3) the pair with the largest difference.
    """

    pairs: int
    rms: float
    noise: float
    typical: float
    largest: float
    where: FloatArray

    def numbers(self) -> dict[str, Any]:
        theta, phi = directions.spherical_from_vector(self.where)
        return {
            "pairs": self.pairs, "relative_rms": self.rms, "relative_rms_of_noise": self.noise,
            "relative_rms_beyond_noise": self.beyond, "relative_typical": self.typical,
            "relative_largest": self.largest,
            "largest_at_deg": {
                "theta_i": float(np.rad2deg(theta[0])), "phi_i": float(np.rad2deg(phi[0])),
                "theta_o": float(np.rad2deg(theta[1])), "phi_o": float(np.rad2deg(phi[1])),
            },
            "within_deg": float(np.rad2deg(WITHIN)),
        }  # fmt: skip

    @property
    def beyond(self) -> float:
        """What of the rms the noise does not explain."""
        return float(np.sqrt(max(self.rms**2 - self.noise**2, 0.0)))

    @property
    def place(self) -> str:
        theta, _ = directions.spherical_from_vector(self.where)
        return f"theta_i = {degrees(float(theta[0]))}, theta_o = {degrees(float(theta[1]))}"


def compare(
    measured: Measured, position: IndexArray, partner: IndexArray, noise: Noise | None, power: float = 0.0
) -> Compared | None:
    """Of samples ``position`` in ``measured.rows`` with the rows ``partner`` of the table.

    noise : where the table states no sigma. power : the values are multiplied by cos(theta_o) to it first.
    """
    if not len(position):
        return None
    columns = measured.channels[None, :]
    one, other = measured.value[position[:, None], columns], measured.table.value[partner[:, None], columns]
    sigma = measured.table.sigma
    if sigma is not None:
        own = measured.rows[position]
        deviation = np.hypot(sigma[own[:, None], columns], sigma[partner[:, None], columns])
    elif noise is not None:
        deviation = np.hypot(noise.deviation(one), noise.deviation(other))
    else:
        deviation = np.zeros_like(one)
    if power:
        # Of the partner theta_o is (nearly) this sample's theta_i.
        cos = [np.maximum(w[position, 2:], 1e-6) ** power for w in (measured.wo, measured.wi)]
        one, other, deviation = one * cos[0], other * cos[1], deviation * np.sqrt(cos[0] * cos[1])
    size = 0.5 * (np.abs(one) + np.abs(other))
    typical = measured.typical[measured.channels]
    usable = size > _NEAR_ZERO * np.where(typical > 0, typical, np.inf)
    if not usable.any():
        return None
    difference = np.where(usable, (one - other) / np.where(usable, size, 1.0), 0.0)
    found = np.abs(difference[usable])
    explained = deviation[usable] / size[usable]
    # A stated sigma that is missing explains nothing; a difference can't be more than 200 %.
    explained = np.clip(np.where(np.isfinite(explained), explained, 0.0), 0.0, 2.0) ** 2
    at = int(np.argmax(np.abs(difference).max(axis=1)))
    return Compared(
        len(position), float(np.sqrt(np.mean(found**2))), float(np.sqrt(explained.mean())),
        float(np.median(found)) / MAD, float(found.max()),
        np.stack([measured.wi[position[at]], measured.wo[position[at]]]),
    )  # fmt: skip


@dataclass(frozen=True)
class Reciprocal:
    """Samples ``position`` in ``measured.rows`` and the rows ``partner`` of the table with wi and wo swapped.

    built_in : the table's coordinates make both one sample.
    """

    position: IndexArray
    partner: IndexArray
    built_in: bool = False


def reciprocal_pairs(measured: Measured) -> Reciprocal:
    """Each pair once; of large tables, the pairs of a subset of the samples."""
    grid = measured.table.grid
    none = np.zeros(0, np.intp)
    if grid is not None and grid.system == "half_difference":
        period = grid.periodic.get("phi_d")
        if (period is not None and period < 1.5 * np.pi) or np.ptp(grid.axes["phi_d"]) < 1.01 * np.pi:
            return Reciprocal(none, none, built_in=True)
    position = measured.draw(_TARGETS)
    position = position[measured.wo[position, 2] > 0]
    if not len(position):
        return Reciprocal(none, none)
    wi, wo = measured.wi[position], measured.wo[position]
    row, distance = measured.nearest(wo, wi)
    # A sample that is its own partner (theta_i = theta_o of an isotropic surface) tests nothing.
    own = measured.features[position] - features(wo, wi, isotropic=measured.isotropic)
    good = (distance <= WITHIN) & (np.linalg.norm(own, axis=1) > 2 * WITHIN)
    position, row = position[good], row[good]
    both = np.sort(np.stack([measured.rows[position], row], axis=1), axis=1)
    _, once = np.unique(both, axis=0, return_index=True)
    return Reciprocal(position[once], row[once])


def reciprocity(measured: Measured, pairs: Reciprocal, noise: Noise | None) -> Finding:
    """Helmholtz reciprocity f(wi, wo) = f(wo, wi) where both were measured."""
    name = "reciprocity"
    if pairs.built_in:
        return not_judged(
            name, "The table holds half a turn of phi_d only, so that reciprocity is built in and can't be "
            "tested.", pairs=0,
        )  # fmt: skip
    found = compare(measured, pairs.position, pairs.partner, noise)
    if found is None or found.pairs < FEWEST:
        count = 0 if found is None else found.pairs
        there = f"Only {count}" if count else "No"
        return not_judged(
            name, f"{there} reciprocal pairs of samples lie within {degrees(WITHIN)} of each other: "
            "reciprocity can't be judged.", pairs=count,
        )  # fmt: skip
    sentence = (
        f"{found.pairs:,} reciprocal pairs differ by {percent(found.rms)} (relative rms), at most "
        f"by {percent(found.largest)} at {found.place}{_compared_with(found)}."
    )
    return Finding(name, graded(found.beyond, DIFFERENT, VERY_DIFFERENT), sentence, found.numbers())


def quantity(measured: Measured, pairs: Reciprocal, noise: Noise | None) -> Finding:
    """Whether reciprocal pairs would agree if the file had held the BRDF with the cosine, or without it.

    Only f_r itself is reciprocal: f_r cos(theta_o) read as f_r breaks reciprocity by cos(theta_i) over
    cos(theta_o), which no surface does.
    """
    name = "quantity"
    declared = measured.table.metadata.quantity
    powers = {"brdf": 0.0, "ccbrdf": -1.0} if declared != "ccbrdf" else {"ccbrdf": 0.0, "brdf": 1.0}
    found = {q: compare(measured, pairs.position, pairs.partner, noise, power) for q, power in powers.items()}
    as_read, otherwise = found.values()
    if as_read is None or otherwise is None or as_read.pairs < FEWEST:
        return not_judged(
            name, f"Without reciprocal pairs the declared quantity ({declared}) can't be confirmed.",
            declared=declared, pairs=0 if as_read is None else as_read.pairs,
        )  # fmt: skip
    other = list(powers)[1]
    numbers: dict[str, Any] = {
        "declared": declared, "pairs": as_read.pairs, "suggested": None,
        "relative_rms": {declared: as_read.rms, other: otherwise.rms},
        "relative_typical": {declared: as_read.typical, other: otherwise.typical},
    }  # fmt: skip
    better = otherwise.typical < 0.5 * as_read.typical and otherwise.rms < as_read.rms
    if better and as_read.beyond > DIFFERENT:
        numbers["suggested"] = other
        sentence = (
            f"Reciprocal pairs typically differ by {percent(as_read.typical)} as read ({declared}), but by "
            f"{percent(otherwise.typical)} if the file holds {other}: the declared quantity is probably "
            "wrong."
        )
        return Finding(name, "warning", sentence, numbers)
    worse = as_read.typical < 0.5 * otherwise.typical
    sentence = (
        f"Reciprocal pairs agree best with the declared quantity ({declared}; they would differ by "
        f"{percent(otherwise.typical)} with {other})."
        if worse
        else f"Reciprocal pairs do not tell {declared} from {other}."
    )
    return Finding(name, "ok", sentence, numbers, judged=worse)


def isotropy(measured: Measured, noise: Noise | None) -> Finding:
    """Samples against those of another incident azimuth that differ by a turn of the surface only."""
    name = "isotropy"
    grid = measured.table.grid
    tilted = np.flatnonzero(np.hypot(measured.wi[:, 0], measured.wi[:, 1]) > AT_NORMAL)
    _, phi = directions.spherical_from_vector(measured.wi[tilted])
    azimuths = _distinct(np.mod(phi, 2 * np.pi))
    if len(azimuths) < 2 or (grid is not None and grid.system != "spherical"):
        return not_judged(
            name, "The sample was measured at one incident azimuth only: whether it is isotropic is not "
            "known from this table.", azimuths=len(azimuths), pairs=0,
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
        c, s = np.cos(turn), np.sin(turn)
        row, distance = measured.nearest(
            directions.turned(measured.wi[position], c, s), directions.turned(measured.wo[position], c, s),
            isotropic=False,
        )  # fmt: skip
        good = distance <= WITHIN
        positions.append(position[good])
        rows.append(row[good])
    found = compare(measured, np.concatenate(positions), np.concatenate(rows), noise)
    numbers: dict[str, Any] = {"azimuths": len(azimuths), "pairs": 0}
    if found is None or found.pairs < FEWEST:
        return not_judged(
            name, f"{len(azimuths)} incident azimuths were measured, but hardly any samples differ by a turn "
            "of the surface only: isotropy can't be judged.", **numbers,
        )  # fmt: skip
    excess = found.beyond
    numbers |= found.numbers()
    said = (
        f"Turning the sample about its normal changes {found.pairs:,} values by {percent(found.rms)} "
        f"(relative rms over {len(azimuths)} incident azimuths{_compared_with(found)})"
    )
    if measured.isotropic:
        verdict = graded(excess, DIFFERENT, VERY_DIFFERENT)
        end = ", as of an isotropic surface" if verdict == "ok" else ", yet the table is taken for isotropic"
        return Finding(name, verdict, f"{said}{end}.", numbers)
    end = ": it is isotropic as far as this shows" if excess <= DIFFERENT else ": it is anisotropic"
    return Finding(name, "ok", f"{said}{end}.", numbers)


def _compared_with(found: Compared) -> str:
    return f"; noise explains up to {percent(found.noise)}" if found.noise > 0 else ""


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.mod(angle + np.pi, 2 * np.pi) - np.pi


def _distinct(phi: FloatArray) -> FloatArray:
    """Azimuths in [0, 2 pi) that differ by more than ``SAME_AZIMUTH``, at most a turn's worth."""
    if not len(phi):
        return phi
    found = np.unique(np.round(phi / SAME_AZIMUTH))
    turn = round(2 * np.pi / SAME_AZIMUTH)
    return np.unique(np.mod(found, turn)) * SAME_AZIMUTH
