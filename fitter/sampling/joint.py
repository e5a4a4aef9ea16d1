"""Incidences and scattered directions drawn together, density proportional to f+ cos(theta_i) cos(theta_o).

Where slices between incidences are blends, f+(wi, wo) = sum_k b_k(wi) f_k(wo, wi): a blend and one of its
members are chosen with probability proportional to that term's mass, then wi by its weight b_k cos(theta_i),
then wo from the member as at its own incidence. What falls outside the region that all members cover is
rejected, and what a member's own envelope rejects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.errors import TableError
from fitter.sampling.alias import AliasTable
from fitter.sampling.arcs import inverted, moments
from fitter.sampling.axes import Axis
from fitter.sampling.envelope import Envelope, JointInfo, Method, empty_slice
from fitter.sampling.grid import GridInterpolant
from fitter.sampling.proposing import Candidates, Proposing
from fitter.sampling.scattered import Part, ScatteredInterpolant, ScatteredSlice
from fitter.sampling.spherical import Node, SphericalSlice

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]

# Longest arc of theta_i that is drawn from as one.
_ARC = 0.13
# Candidates from which the accepted share, and so the integral, is estimated.
_PROBE = 1 << 17
_PROBE_PART = 1 << 13

Evaluate = Callable[[FloatArray, FloatArray], tuple[FloatArray, BoolArray]]


@dataclass(frozen=True)
class Piece:
    """One term on one piece of incidences: a rectangle of (theta_i, phi_i), or a triangle of the disk.

    member : which envelope. theta, phi : ends; ramp : b at theta's ends, turn : b along phi. corners : (3, 2)
    of a triangle instead, where b is the hat of the first. bracket : which blend (scattered tables).
    """

    member: int
    theta: tuple[float, float] = (0.0, 0.0)
    ramp: tuple[float, float] = (1.0, 1.0)
    phi: tuple[float, float] = (-np.pi, np.pi)
    turn: tuple[float, float] = (1.0, 1.0)
    corners: FloatArray | None = None
    bracket: int = 0

    @property
    def mass(self) -> float:
        """Integral of b cos(theta_i) over the piece."""
        if self.corners is not None:
            a, b = self.corners[1] - self.corners[0], self.corners[2] - self.corners[0]
            return abs(float(a[0] * b[1] - a[1] * b[0])) / 6
        height = self.theta[1] - self.theta[0]
        low, high = moments(np.array([self.theta[0]]), np.array([height]))
        along = float(self.ramp[0] * low[0] + self.ramp[1] * high[0])
        return along * 0.5 * (self.turn[0] + self.turn[1]) * (self.phi[1] - self.phi[0])


class BlendedJoint(Proposing):
    """Pairs of a table whose slices are blends.

    moved : (wi (m, 3), wo (m, 3), pieces (m,)) -> wo where the blend has the member's value.
    """

    def __init__(
        self, pieces: Sequence[Piece], members: Sequence[Envelope], evaluate: Evaluate, weights: FloatArray,
        moved: Callable[[FloatArray, FloatArray, IndexArray], FloatArray], *, isotropic: bool, exact: bool,
    ) -> None:  # fmt: skip
        self._pieces, self._members, self._evaluate, self._weights = pieces, members, evaluate, weights
        self._moved, self._isotropic = moved, isotropic
        self._member = np.array([piece.member for piece in pieces])
        of = np.array([one.integral / one.acceptance for one in members])
        mass = np.array([piece.mass for piece in pieces])
        total = mass * of[self._member]
        self._alias = AliasTable(total)
        ends = [(*p.theta, *p.ramp, *p.phi, *p.turn) for p in pieces]
        self._ends = tuple(np.array(column) for column in zip(*ends, strict=True))
        no_corners = np.zeros((3, 2))
        self._corners = np.stack([no_corners if p.corners is None else p.corners for p in pieces])
        if exact:
            kept = mass * np.array([one.integral for one in members])[self._member]
            error = max(one.info.integral_error for one in members)
            self.info = JointInfo(float(kept.sum()), error, float(kept.sum() / total.sum()))
        else:
            self.info = estimated(self, float(total.sum()))

    def draw(self, rng: np.random.Generator, m: int) -> Candidates:
        """``m`` pairs."""
        piece = self._alias.choose(rng.random(m))
        wi = self._incidences(rng, piece)
        wo, accepted = np.zeros((m, 3)), np.zeros(m, bool)
        member = self._member[piece]
        order = np.argsort(member, kind="stable")
        edges = np.flatnonzero(np.diff(member[order], prepend=-1))
        for mine in np.split(order, edges[1:]):
            wo[mine], accepted[mine] = self._members[int(member[mine[0]])].kernel.candidates(rng, len(mine))
        wo = self._moved(wi, wo, piece)
        if self._isotropic:
            turn = rng.uniform(-np.pi, np.pi, m)
            wi, wo = (directions.turned(w, np.cos(turn), np.sin(turn)) for w in (wi, wo))
        inside = wo[:, 2] > 0
        values = np.zeros((m, len(self._weights)))
        some = np.flatnonzero(accepted & inside)
        values[some], outside = self._evaluate(wi[some], wo[some])
        accepted[~inside] = False
        accepted[some[outside]] = False
        return Candidates((*wi.T, *wo.T), accepted, values @ self._weights, (values,))

    def channels(self, place: tuple[NDArray[Any], ...]) -> FloatArray:
        """(m, C) f+ of every channel."""
        return place[0]

    def _incidences(self, rng: np.random.Generator, piece: IndexArray) -> FloatArray:
        m = len(piece)
        u = rng.random((3, m))
        theta0, theta1, a, b, phi0, phi1, c, d = (column[piece] for column in self._ends)
        if self._pieces[0].corners is None:
            height = theta1 - theta0
            theta = theta0 + inverted(u[0], a, b, np.sin(2 * theta0), np.cos(2 * theta0), height) * height
            if self._isotropic:
                return directions.vector_from_spherical(theta, 0.0)
            # c + (d - c) t, inverted in the form that does not cancel.
            t = u[1] * (c + d) / (c + np.sqrt(c * c + u[1] * (d * d - c * c)))
            return directions.vector_from_spherical(theta, phi0 + t * (phi1 - phi0))
        u = np.sort(u, axis=0)
        corners = self._corners[piece]
        share = np.stack([u[1], u[2] - u[1], 1 - u[2]], axis=1)
        point = np.einsum("mi,mij->mj", share, corners)
        z = np.sqrt(np.maximum(1 - (point**2).sum(axis=1), 0.0))
        return np.concatenate([point, z[:, None]], axis=1)


def estimated(envelope: Proposing, total: float) -> JointInfo:
    """The integral as the envelope's ``total`` times the accepted share of candidates of a fixed seed."""
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(_PROBE // _PROBE_PART):
        hits += int(np.count_nonzero(envelope.draw(rng, _PROBE_PART).accepted))
    if hits == 0:
        raise empty_slice()
    share = hits / _PROBE
    return JointInfo(total * share, float(np.sqrt((1 - share) / hits)), share)


def of_spherical(
    grid: GridInterpolant, weights: FloatArray, acceptance: float, cells: int, method: Method
) -> BlendedJoint:
    """Of a grid in incoming and outgoing angles: members are the grid's incidences, f+ is a blend of them."""
    incoming, outgoing = grid.axes[:-2], grid.axes[-2:]
    size = len(outgoing[0].nodes) * len(outgoing[1].nodes)
    usable = grid.mask.reshape(-1, size)
    value = grid.value.reshape(-1, size, grid.value.shape[1])
    pieces: list[Piece] = []
    members: list[Envelope] = []
    known: dict[tuple[int, bytes], int | None] = {}
    azimuths: list[Arc] = [((-np.pi, np.pi), ((0, (1.0, 1.0)),))]
    if len(incoming) == 2:
        azimuths = _arcs(incoming[1], polar=False)
    columns = len(incoming[1].nodes) if len(incoming) == 2 else 1
    for theta, along in _arcs(incoming[0], polar=True):
        for phi, across in azimuths:
            around = [(i * columns + j, ramp, turn) for i, ramp in along for j, turn in across]
            common = np.logical_and.reduce([usable[node] for node, _, _ in around])
            for node, ramp, turn in around:
                key = node, common.tobytes()
                if key not in known:
                    there = np.where(usable[node][:, None], value[node], 0.0)
                    one = (Node(1.0, there, grid.energy(int(node)).root),)
                    part = SphericalSlice(outgoing, one, common, 0.0, False)
                    known[key] = _member(
                        members, lambda p=part: p.envelope(weights, acceptance, cells, method)
                    )
                member = known[key]
                if member is not None:
                    pieces.append(Piece(member, theta, ramp, phi, turn))
    if not pieces:
        raise empty_slice()
    plain = GridInterpolant(grid.grid, np.maximum(grid.value, 0.0), grid.mask) if grid.has_negatives else grid
    return BlendedJoint(
        pieces, members, plain.evaluate, weights, lambda _wi, wo, _piece: wo,
        isotropic=len(incoming) == 1, exact=True,
    )  # fmt: skip


def _member(members: list[Envelope], build: Callable[[], Envelope]) -> int | None:
    """Where in ``members`` what is built stands; None where nothing of it is positive."""
    try:
        members.append(build())
    except TableError as error:
        if error.code != "slice-empty":
            raise
        return None
    return len(members) - 1


Arc = tuple[tuple[float, float], tuple[tuple[int, tuple[float, float]], ...]]


def _arcs(axis: Axis, *, polar: bool) -> list[Arc]:
    """Measured arcs of an axis of incidences: their ends, and for each node its weight at both ends."""
    edges = axis.breakpoints(*((0.0, np.pi / 2) if polar else (-np.pi, np.pi)))
    if polar:
        fine = [np.linspace(a, b, int(np.ceil((b - a) / _ARC)) + 1) for a, b in pairwise(edges)]
        edges = np.unique(np.concatenate(fine))
    found: list[Arc] = []
    for low, high in pairwise(edges):
        inset = 1e-9 * (high - low)
        at = np.array([low + inset, 0.5 * (low + high), high - inset])
        if not polar:
            start = axis.nodes[0]
            at = start + np.mod(at - start, axis.period or 2 * np.pi)
        place = axis.locate(at)
        if not place.measured.all():
            continue
        first, second = int(place.low[1]), int(place.high[1])
        t = np.round(place.fraction[[0, 2]], 8) if first != second else np.zeros(2)
        nodes = [(first, (float(1 - t[0]), float(1 - t[1])))]
        if first != second:
            nodes.append((second, (float(t[0]), float(t[1]))))
        found.append(((float(low), float(high)), tuple(nodes)))
    return found


def of_scattered(
    table: ScatteredInterpolant, weights: FloatArray, acceptance: float, cells: int, method: Method
) -> BlendedJoint:
    """Of a scattered table: members are its scans, which move with wi on the disk."""
    if len(table.scans) < 2:
        raise TableError(
            "the table has one incidence: nothing is known of others", code="too-few-incidences",
            remedy="draw for that incidence alone",
        )  # fmt: skip
    members: list[Envelope] = []
    number = {
        k: _member(
            members,
            lambda s=scan: ScatteredSlice((Part(1.0, s, np.zeros(2)),), 0.0, False).envelope(
                weights, acceptance, cells, method
            ),
        )
        for k, scan in enumerate(table.scans)
    }
    pieces: list[Piece] = []
    scans: list[int] = []
    for bracket, around in enumerate(table.brackets):
        incidence = np.stack([table.scans[k].incidence for k in around])
        for j, k in enumerate(around):
            member = number[int(k)]
            if member is None:
                continue
            if len(around) == 3:
                some = [Piece(member, corners=np.roll(incidence, -j, axis=0), bracket=bracket)]
            else:
                low, high = np.arcsin(np.clip(incidence[:, 0], 0.0, 1.0))
                edges = np.linspace(low, high, int(np.ceil((high - low) / _ARC)) + 1)
                t = (edges - low) / (high - low)
                b = t if j else 1 - t
                some = [
                    Piece(member, (edges[i], edges[i + 1]), (b[i], b[i + 1]), bracket=bracket)
                    for i in range(len(edges) - 1)
                ]
            pieces += some
            scans += [int(k)] * len(some)
    if not pieces:
        raise empty_slice()
    brackets, which = np.array([piece.bracket for piece in pieces]), np.array(scans)

    def moved(wi: FloatArray, wo: FloatArray, piece: IndexArray) -> FloatArray:
        point = wo[:, :2].copy()
        for k in np.unique(which[piece]):
            mine = np.flatnonzero(which[piece] == k)
            point[mine] += table.shift(wi[mine, :2], table.scans[k], brackets[piece[mine]])
        z2 = 1 - (point**2).sum(axis=1)
        return np.concatenate([point, np.where(z2 > 0, np.sqrt(np.maximum(z2, 0.0)), -1.0)[:, None]], axis=1)

    clamped = replace(table, scans=tuple(replace(scan, value=scan.clamped) for scan in table.scans))
    # The motion is that of the values as measured.
    vars(clamped)["_motions"] = {b: table.motion(b) for b in range(len(table.brackets))}
    return BlendedJoint(
        pieces, members, clamped.evaluate, weights, moved, isotropic=table.isotropic, exact=False
    )
