"""Repeated geometries, grids and azimuths found in little time: the same as found in the plainest way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter import directions, parts, repeats, table
from fitter.errors import TableError
from fitter.formats import geometry as geo
from fitter.repeats import STEP, repeated

LEVELS = st.sampled_from(
    [0.0, -0.0, 1.0, -1.0, 0.5, 0.5 + STEP / 4, 0.5 + STEP, 1 + 4e-7, np.nan, np.inf, -np.inf]
)
VECTOR = st.tuples(LEVELS, LEVELS, LEVELS)


def plainly(wi: np.ndarray, wo: np.ndarray) -> list[bool]:
    seen: set[tuple[str, ...]] = set()
    found = []
    for row in np.concatenate([wi, wo], axis=1):
        key = tuple(str(round(x / STEP)) if np.isfinite(x) else str(x) for x in row.tolist())
        found.append(key in seen)
        seen.add(key)
    return found


@given(st.lists(st.tuples(VECTOR, VECTOR), min_size=1, max_size=40))
def test_repeats(pairs: list[tuple[tuple[float, ...], tuple[float, ...]]]):
    wi, wo = (np.array([pair[k] for pair in pairs]) for k in (0, 1))
    assert repeated(wi, wo).tolist() == plainly(wi, wo)


@pytest.mark.parametrize("part", [7, 1 << 15])
def test_many_repeats(part: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(parts, "ROWS", part)
    monkeypatch.setattr(repeats, "_MANY", part)
    rng = np.random.default_rng(1)
    w = rng.standard_normal((2, 200, 3))
    w /= np.linalg.norm(w, axis=-1, keepdims=True)
    pick = rng.integers(0, 200, (2, 3000)) % np.array([[200], [3]])
    assert repeated(w[0, pick[0]], w[1, pick[1]]).tolist() == plainly(w[0, pick[0]], w[1, pick[1]])


def test_many_rows_are_shared_by_threads(monkeypatch: pytest.MonkeyPatch):
    """As one thread does it; what the caller says about overflow holds, and what is raised arrives."""
    monkeypatch.setattr(parts, "_MANY", 1)
    monkeypatch.setattr(parts, "ROWS", 10)
    monkeypatch.setattr(parts.os, "cpu_count", lambda: 3)
    theta, phi = np.random.default_rng(1).uniform(0, 1, (2, 1005))
    theta[500] = np.inf
    with np.errstate(invalid="ignore"):
        found = directions.vector_from_spherical(theta, phi)
        expected = np.stack(directions.spherical_components(theta, phi), axis=1)
    np.testing.assert_array_equal(found, expected)

    def fail(part: slice) -> None:
        raise ValueError(part.start)

    with pytest.raises(ValueError, match=r"^0$"):
        parts.in_parts(fail, 1005)
    w = np.array(expected[:400])
    w[[37, 250]] *= 2
    with pytest.raises(TableError, match="row 38 of wi is"):
        table.Table(wi=w, wo=expected[:400], value=np.ones(400))


def test_directions_are_copied_unless_they_are_given_away():
    w = directions.vector_from_spherical(np.array([0.1, np.pi / 2]), 0.0)
    kept = table.Table(wi=w[:1], wo=w[:1], value=[1.0])
    assert not np.shares_memory(kept.wi, w)
    given = table.Table(wi=w[:1], wo=w[1:], value=[1.0], copy=False)
    assert np.shares_memory(given.wo, w)
    assert w[1, 2] == 0.0


def test_what_mixes_to_one_number_is_compared_in_full(monkeypatch: pytest.MonkeyPatch):
    """As if the mixing were as bad as it could be."""
    rng = np.random.default_rng(2)
    w = rng.standard_normal((60, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    w[40:] = w[:20]
    monkeypatch.setattr(repeats, "_mixed", lambda first, second: first % 2)
    assert repeated(w, -w).tolist() == [False] * 40 + [True] * 20


@given(
    st.lists(st.integers(2, 5), min_size=3, max_size=3),
    st.randoms(use_true_random=False),
    st.sampled_from(["whole", "missing", "repeated", "swapped"]),
)
def test_grids(shape: list[int], random: object, how: str):
    rng = np.random.default_rng(random.getrandbits(32))  # type: ignore[attr-defined]
    axes = [np.sort(rng.choice(80, n, replace=False)) / 57.3 for n in shape]
    axes[2] = axes[2] * 4
    mesh = np.stack([a.reshape(-1) for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    rows = mesh[rng.permutation(len(mesh))]
    if how == "missing":
        rows = rows[1:]
    elif how == "repeated":
        rows[0] = rows[1]
    elif how == "swapped":
        rows = np.concatenate([rows[1:], rows[1:2]])
    c = tuple(rows.T)
    geometry = geo.Geometry(rows, rows, "", coordinates={"spherical_isotropic": c})
    found = geo.find_grid(geometry)
    assert (found is not None) == (how == "whole")
    if found is not None:
        grid, order = found
        assert all(np.array_equal(a, b) for a, b in zip(axes, grid.axes.values(), strict=True))
        np.testing.assert_array_equal(rows[order], mesh)


def test_a_node_that_few_rows_have():
    """Some of the rows don't show every node: the rest are looked at too."""
    c = np.zeros(200_000)
    c[[101, 90_003]] = [2.0, 1.0]
    first, place = geo._nodes(c)
    assert first.tolist() == [0, 90_003, 101]
    assert (c[first][place] == c).all()


def test_one_azimuth_among_many_rows():
    theta = np.full(50_000, 0.5)
    phi = np.full(50_000, 1.0)
    wo = directions.vector_from_spherical(np.linspace(0, 1.5, 50_000), 0.3)
    assert (
        table.Table(wi=directions.vector_from_spherical(theta, phi), wo=wo, value=theta).symmetry
        == "isotropic"
    )
    phi[12_347] = 1.1  # not among those that are looked at first
    assert (
        table.Table(wi=directions.vector_from_spherical(theta, phi), wo=wo, value=theta).symmetry
        == "anisotropic"
    )
