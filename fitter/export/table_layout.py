"""Where the samples of an isotropic table lie in an RGL file: as many as keep to its interpolant.

What such a file says of a pair of directions depends on 8 samples, so its error is known before it is written
(as in :mod:`fitter.export.half_vectors`). Between incidences the format interpolates at a fixed place in the
lobe, a table otherwise: of a glossy one, incidences have to be close.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.export import energy
from fitter.export.fidelity import even_pairs, seen
from fitter.export.half_vectors import LARGEST
from fitter.export.subject import Subject
from fitter.formats.rgl_writer import WIDEST, Layout, incidences, lobe_width, parameterisation
from fitter.sampling.warp import Corner, lookup

FloatArray = NDArray[np.float64]

#: Degrees between incidences at most, and samples of one on each axis: from the coarsest to the finest.
_LADDER = ((7.0, 64), (7.0, 128), (3.5, 128), (3.5, 256), (1.75, 256), (1.25, 256), (1.0, 256), (0.85, 256))
#: The p95 that is aimed at, below the 1 % that is stated: what is predicted is of few pairs.
_GOAL, _PAIRS, _INCIDENCES = 0.007, 2000, 100
#: What is stated of RGL files.
STATED = 0.01
#: What is as good as the best.
_LITTLE = 1.2
#: Fewer pairs than that, even over the hemispheres, and nothing is predicted.
_FEWEST = 200


def table_pairs(subject: Subject, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Pairs (M, 3) where the table was measured: half even over both hemispheres up to 80 deg, half nearly by
    its f_r cos(theta_o)."""
    wi, wo = even_pairs(subject, count // 2, seed)
    incidence = wi[np.linspace(0, len(wi) - 1, _INCIDENCES).astype(np.intp)]
    more = energy.drawn(subject, incidence, count // 2 // _INCIDENCES, seed)
    return np.concatenate([wi, more[0]]), np.concatenate([wo, more[1]])


def chosen(subject: Subject) -> tuple[Layout, float] | None:
    """The smallest layout that is expected to keep to the goal, or the best, and the p95 expected. None of a
    table of so few directions that hardly any others are between them."""
    table = subject.table
    assert table is not None
    index = np.flatnonzero(table.mask)
    own, out = table.directions(index)
    width = lobe_width(own, out, table.value[index].mean(axis=1))
    if len(even_pairs(subject, _PAIRS, 1)[0]) < _FEWEST:
        return None
    wi, wo = table_pairs(subject, _PAIRS, 1)
    ours, outside = subject.evaluate(wi, wo)
    known = ~outside & seen(ours)
    found: list[tuple[float, int, Layout]] = []
    for (apart, steps), alpha in product(_LADDER, sorted({width, WIDEST})):
        one = Layout(*incidences(table, own, np.deg2rad(apart)), alpha, steps)
        size = one.theta_i.size * one.steps**2 * (4 * max(len(subject.channels), 3) + 5)
        if found and (min(entry[0] for entry in found) <= _GOAL or size > LARGEST):
            continue
        found.append((expected(subject, one, wi[known], wo[known], ours[known]), size, one))
    least = min(error for error, *_ in found)
    # Where the goal is out of reach, a file many times as large is not worth a little.
    most = _GOAL if least <= _GOAL else _LITTLE * least
    near = [entry for entry in found if entry[0] <= most]
    error, _, best = min(near, key=lambda entry: entry[1])
    return best, error


def expected(subject: Subject, layout: Layout, wi: FloatArray, wo: FloatArray, ours: FloatArray) -> float:
    """The 95 % quantile of the relative error at pairs (M, 3) with values (M, C)."""
    if not len(wi):
        return 0.0
    bare = parameterisation(layout.theta_i, layout.phi_i, layout.alpha, 2)
    theta_i, phi_i = directions.spherical_from_vector(wi)
    theta_m, phi_m = directions.spherical_from_vector(wi + wo)
    u, v = np.sqrt(theta_m * (2 / np.pi)), np.mod((phi_m - phi_i) / (2 * np.pi) + 0.5, 1.0)
    blend = bare.blend(wi)
    n = layout.steps
    corner = Corner.of((n, n), *bare.warp.inverse(blend, u, v))
    total = np.zeros(ours.shape)

    def factor(theta: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
        return lookup(bare.ndf, u, v) / (4 * lookup(bare.sigma, np.sqrt(theta * (2 / np.pi)), 0 * theta))

    for (node, share), i, j in product(blend, (0, 1), (0, 1)):
        x, y = (corner.i + i) / (n - 1), (corner.j + j) / (n - 1)
        there = np.empty((2, len(wi)))
        for k in np.unique(node):
            here = node == k
            there[:, here] = bare.warp.forward(int(k), x[here], y[here])
        incident = directions.vector_from_spherical(layout.theta_i[node], phi_i)
        angle = (2 * there[1] - 1) * np.pi + phi_i
        m = directions.vector_from_spherical(there[0] ** 2 * (np.pi / 2), angle)
        out = 2 * (incident * m).sum(axis=1)[:, None] * m - incident
        value = subject.evaluate(incident, np.concatenate([out[:, :2], np.abs(out[:, 2:])], axis=1))[0]
        cosine = np.maximum(out[:, 2], 0.0) / factor(layout.theta_i[node], *there)
        weight = (corner.x if i else 1 - corner.x) * (corner.y if j else 1 - corner.y) * share
        total += (weight * cosine)[:, None] * np.where(np.isfinite(value), value, 0.0)
    theirs = total * (factor(theta_i, u, v) / wo[:, 2])[:, None]
    return float(np.quantile(np.abs(theirs - ours) / ours, 0.95))
