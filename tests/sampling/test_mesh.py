"""Common meshes of piecewise linear functions, and integrals over arcs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from fitter.sampling.arcs import inverted, moments
from fitter.sampling.mesh import Mesh, halved, overlay


def random_mesh(rng: np.random.Generator, count: int, gradient: np.ndarray) -> Mesh:
    points = rng.uniform(-1, 1, (count, 2))
    corners = points[Delaunay(points).simplices]
    return Mesh(corners, (corners @ gradient + 3.0)[..., None])


@settings(max_examples=20)
@given(st.integers(0, 2**31), st.integers(4, 40), st.integers(4, 40))
def test_an_overlay_is_the_sum_where_both_are(seed: int, first: int, second: int) -> None:
    rng = np.random.default_rng(seed)
    one = random_mesh(rng, first, np.array([1.0, 0.5]))
    other = random_mesh(rng, second, np.array([-0.3, 0.2]))
    both = overlay(one, other)
    expected = both.corners @ np.array([0.7, 0.7]) + 6.0
    np.testing.assert_allclose(both.values[..., 0], expected, atol=1e-6)
    assert both.areas.sum() <= min(one.areas.sum(), other.areas.sum()) * (1 + 1e-9)
    # Its area by counting points that are in a triangle of either.
    points = rng.uniform(-1, 1, (4000, 2))
    inside = [Delaunay(mesh.corners.reshape(-1, 2)).find_simplex(points) >= 0 for mesh in (one, other)]
    share = (inside[0] & inside[1]).mean()
    assert both.areas.sum() == pytest.approx(4 * share, abs=0.2)


def test_the_overlay_of_a_mesh_with_itself_has_its_area() -> None:
    mesh = random_mesh(np.random.default_rng(1), 200, np.array([1.0, 2.0]))
    both = overlay(mesh, mesh)
    assert both.areas.sum() == pytest.approx(mesh.areas.sum(), rel=1e-9)
    np.testing.assert_allclose(both.integrals().sum(), 2 * mesh.integrals().sum(), rtol=1e-9)


def test_meshes_apart_have_nothing_in_common() -> None:
    mesh = random_mesh(np.random.default_rng(1), 20, np.array([1.0, 2.0]))
    assert len(overlay(mesh, Mesh(mesh.corners + 5.0, mesh.values)).corners) == 0


def test_halving_changes_no_integral() -> None:
    rng = np.random.default_rng(3)
    mesh = random_mesh(rng, 50, np.array([1.0, 2.0]))
    fine = halved(mesh, rng.random(len(mesh.corners)) < 0.5)
    assert len(fine.corners) > len(mesh.corners)
    np.testing.assert_allclose(fine.integrals().sum(), mesh.integrals().sum(), rtol=1e-12)
    np.testing.assert_allclose(fine.corners @ np.array([1.0, 2.0]) + 3.0, fine.values[..., 0], atol=1e-12)


def test_arcs_are_integrated_and_inverted_to_rounding() -> None:
    rng = np.random.default_rng(0)
    m = 4000
    theta, height = rng.uniform(0, 1.44, m), 10.0 ** rng.uniform(-6, np.log10(0.13), m)
    theta[::5] = 0.0
    a, b = rng.random((2, m))
    a[::7], b[::11] = 0.0, 0.0
    a[::77] = 1.0
    x, weight = np.polynomial.legendre.leggauss(12)

    def integral(s: np.ndarray) -> np.ndarray:
        at = 0.5 * s[:, None] * (1 + x)
        value = (
            (a[:, None] + (b - a)[:, None] * at) * 0.5 * np.sin(2 * (theta[:, None] + at * height[:, None]))
        )
        return 0.5 * s * (value @ weight) * height

    low, high = moments(theta, height)
    whole = integral(np.ones(m))
    np.testing.assert_allclose(a * low + b * high, whole, rtol=1e-12)
    u = rng.random(m)
    u[:3] = 0.0
    s = inverted(u, a, b, np.sin(2 * theta), np.cos(2 * theta), height)
    assert ((s >= 0) & (s <= 1)).all()
    np.testing.assert_allclose(integral(s) / whole, u, atol=1e-11)
