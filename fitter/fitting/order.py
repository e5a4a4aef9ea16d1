"""Order among equals: parameter vectors that differ by labels alone are brought to one of them.

Lobes can be numbered in any order. An anisotropic surface is the same with its axes swapped and turned by a
quarter turn, (x, y, psi) = (y, x, psi + 90 deg), and psi has a period of half a turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter.fitting.layout import Layout
from fitter.fitting.polish import Normal

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
#: Parameters along and across the azimuth psi, the one that is smaller in order first: lobes are narrower
#: along psi, and a narrow lobe has a small alpha and a large exponent.
AXES = (("alpha_x", "alpha_y"), ("nv", "nu"))


def interchangeable(layout: Layout) -> list[list[int]] | None:
    """Positions in ``free`` of each lobe's own parameters; None unless there are several, all alike."""
    count = layout.spec.lobes
    suffixes = [f"_{lobe + 1}" for lobe in range(count)]
    own = [[k for k, name in enumerate(layout.free) if name.endswith(suffix)] for suffix in suffixes]
    kinds = {
        tuple(
            (layout.free[k].rpartition("_")[0], layout.lower[k], layout.upper[k], layout.own[k]) for k in ks
        )
        for ks in own
    }
    return own if count > 1 and len(kinds) == 1 and own[0] else None


def order_lobes(layout: Layout, p: FloatArray) -> FloatArray:
    """The vector p with interchangeable lobes ordered from broad to narrow. Only labels change.

    Where every parameter of a lobe is its channel's own, each channel has its own order. The coefficients
    may be missing from p = u.
    """
    lobes, count, t = interchangeable(layout), layout.spec.lobes, len(layout.entries)
    exponents = [k for k, name in enumerate(layout.free) if name.startswith("n_")]
    if lobes is None or len(exponents) != count:
        return p
    u = p[:t].copy()
    first = int(layout.spec.diffuse == "lambert")
    b = p[t:].reshape(first + count, -1).copy()
    apart = layout.mixed and all(layout.own[k] for k in lobes[0])
    for block in [[c] for c in range(layout.channels)] if apart else [list(range(layout.channels))]:
        places = [np.unique(layout.where[block][:, names]) for names in lobes]
        order = np.argsort([p[layout.where[block, k]].mean() for k in exponents], kind="stable")
        columns = block if apart else list(range(b.shape[1]))
        rows = b[first:][:, columns].reshape(count, -1)
        for place, lobe in enumerate(order):
            u[places[place]] = p[places[lobe]]
            if b.shape[1]:
                b[first + place, columns] = rows[lobe]
    return np.concatenate([u, b.reshape(-1)])


@dataclass(frozen=True)
class Swap:
    """One exchange of the axes of a surface. All fields are entries of u: of the pairs (first, second), one
    along and one across the azimuth, the first being the smaller in order; of azimuths; and of Lafortune's
    delta with the gamma of the same lobe."""

    first: IntArray
    second: IntArray
    psi: IntArray
    delta: IntArray
    gamma: IntArray

    def wanted(self, u: FloatArray) -> NDArray[np.bool_]:
        """(...) True where the axes of u (..., T) are not in their order."""
        excess = (u[..., self.first] - u[..., self.second]).sum(axis=-1)
        return excess + (np.abs(u[..., self.delta]) - 0.25 * math.pi).sum(axis=-1) > 0

    def apply(self, u: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """The exchanged u (..., T), which entry (T,) each one was, and its sign (..., T); the rest is a
        shift."""
        order, sign = np.arange(u.shape[-1]), np.ones(u.shape)
        order[self.first], order[self.second] = self.second, self.first
        # (cos delta, sin delta) exchanged; below 0 that is (-cos, -sin) of -delta - 90 deg, and gamma turns.
        below = u[..., self.delta] < 0
        sign[..., self.delta] = -1.0
        sign[..., self.gamma] = np.where(below, -1.0, 1.0)
        found = sign * u[..., order]
        found[..., self.delta] += np.where(below, -0.5, 0.5) * math.pi
        found[..., self.psi] += 0.5 * math.pi
        return found, order, sign

    def across(self, u: FloatArray) -> FloatArray:
        """Lobes' u (..., T) in their order reflected at its border, where the deltas are 45 deg from 0 on
        average, by their name within it. At the border itself only the name changes: gammas of deltas below 0
        turn, and psi goes on by a quarter turn. An involution that keeps volumes; u stays where it is if a
        delta would lose its sign."""
        size = np.abs(u[..., self.delta])
        size = size - 2.0 * (size - 0.25 * math.pi).mean(axis=-1, keepdims=True)
        beyond = u.copy()
        beyond[..., self.delta] = np.copysign(size, u[..., self.delta])
        possible = (size <= 0.5 * math.pi).all(axis=-1, keepdims=True)
        return np.where(possible, self.apply(beyond)[0], u)


def azimuths(layout: Layout) -> IntArray:
    """The entries of u that are azimuths of a surface's axes and free to go through a whole period."""
    low, high = layout.box
    found = [
        entry
        for entry, (k, _) in enumerate(layout.entries)
        if _is_azimuth(layout.free[k]) and high[entry] - low[entry] >= 2 * math.pi * (1 - 1e-12)
    ]
    return np.array(found, np.intp)


def swaps(layout: Layout) -> tuple[Swap, ...]:
    """The exchanges of axes that leave the model as it is: one per channel that has axes of its own, one
    for channels that share something of them."""
    found: list[Swap] = []
    position = {name: k for k, name in enumerate(layout.free)}
    every = [p.name for p in layout.family.parameter_table(layout.spec) if not p.linear]
    for psi in sorted({layout.entries[e][0] for e in azimuths(layout)}):
        prefix = layout.free[psi].removesuffix("psi")
        pairs = [(prefix + a, prefix + b) for a, b in AXES if prefix + a in every]
        deltas = [name for name in every if name.startswith(f"{prefix}delta")]
        gammas = [name.replace("delta", "gamma") for name in deltas]
        used = [*deltas, *gammas, *(name for pair in pairs for name in pair)]
        if (not deltas and not pairs) or any(name not in position for name in used):
            continue
        box = list(zip(layout.lower, layout.upper, layout.own, strict=True))
        if any(box[position[a]] != box[position[b]] for a, b in pairs):
            continue
        if any(box[position[name]][0] != -box[position[name]][1] for name in [*deltas, *gammas]):
            continue
        own = {name: layout.mixed and layout.own[position[name]] for name in used}
        # Where deltas of one gamma may have either sign, gamma can't turn with them.
        if any(own[d] and not own[g] for d, g in zip(deltas, gammas, strict=True)):
            continue
        apart = layout.mixed and layout.own[psi] and all(layout.own[position[name]] for name in used)
        for block in [[c] for c in range(layout.channels)] if apart else [list(range(layout.channels))]:
            fields = (
                [a for a, _ in pairs], [b for _, b in pairs], [layout.free[psi]], deltas, gammas
            )  # fmt: skip
            found.append(Swap(*(_entries(layout, block, [position[n] for n in names]) for names in fields)))
    return tuple(found)


def _entries(layout: Layout, block: list[int], positions: list[int]) -> IntArray:
    """The entries of u of the parameters at ``positions`` in ``free``, in the channels ``block``."""
    each = [np.unique(layout.where[block, k]) for k in positions]
    return np.concatenate(each) if each else np.zeros(0, np.intp)


def ordered_axes(layout: Layout, u: FloatArray, centre: FloatArray | None = None) -> FloatArray:
    """Vectors u (..., T) with the axes of the surface in their order and its azimuths, as far as they are
    free, less than a quarter turn from those of ``centre`` (T,), or of 0. The model stays what it is."""
    for swap in swaps(layout):
        u = np.where(swap.wanted(u)[..., None], swap.apply(u)[0], u)
    where = azimuths(layout)
    if len(where):
        middle = 0.0 if centre is None else centre[where]
        u = u.copy()
        u[..., where] = middle + np.mod(u[..., where] - middle + 0.5 * math.pi, math.pi) - 0.5 * math.pi
    return u


def in_order(layout: Layout, p: FloatArray) -> FloatArray:
    """The vector p = [u, inner], or u alone, with lobes and axes in their order."""
    t = len(layout.entries)
    p = order_lobes(layout, p)
    return np.concatenate([ordered_axes(layout, p[:t]), p[t:]])


def order_axes(layout: Layout, p: FloatArray, normal: Normal) -> tuple[FloatArray, Normal]:
    """The vector p with :func:`ordered_axes`, and its normal equations in the same order."""
    t = len(layout.entries)
    order, sign, u = np.arange(len(p)), np.ones(len(p)), p[:t]
    for swap in swaps(layout):
        if swap.wanted(u):
            u, places, signs = swap.apply(u)
            order[:t], sign[:t] = order[:t][places], signs * sign[:t][places]
    both, outer = np.ix_(order, order), np.outer(sign, sign)
    turned = normal._replace(matrix=normal.matrix[both] * outer, rhs=normal.rhs[order] * sign)
    return np.concatenate([ordered_axes(layout, p[:t]), p[t:]]), turned


def _is_azimuth(name: str) -> bool:
    return name == "psi" or name.endswith("_psi")
