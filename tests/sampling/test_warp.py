"""The warp of a bilinear density: exact, invertible, and what blending densities means."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter.sampling.warp import Warp, lookup, lookup_blend


def alone(node: int, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(np.full(count, node), np.ones(count))]


@given(st.integers(0, 10**6))
def test_forward_and_inverse(seed: int):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(2, 9, 2))
    warp = Warp(rng.uniform(0.01, 1, (3, *shape)) ** 3)
    s, t = rng.uniform(0, 1, (2, 200))
    s[:4], t[:4] = [0, 1, 0, 1], [0, 0, 1, 1]
    for node in range(3):
        x, y = warp.forward(node, s, t)
        back = warp.inverse(alone(node, 200), x, y)
        np.testing.assert_allclose(back, [s, t], atol=1e-12)
        np.testing.assert_allclose([x[:4], y[:4]], [s[:4], t[:4]], atol=1e-15)


def test_its_density_is_the_image():
    """The area of the square that is mapped into a cell is the integral of the image over it."""
    rng = np.random.default_rng(5)
    image = rng.uniform(0, 1, (4, 6))
    warp = Warp(image[None])
    x, y = 0.31, 0.62
    s, t = warp.inverse(alone(0, 1), np.array([x]), np.array([y]))
    k = (np.arange(400) + 0.5) / 400
    gx, gy = (g.reshape(-1) for g in np.meshgrid(k, k * y))
    total = lookup(image, *(g.reshape(-1) for g in np.meshgrid(k, k))).mean()
    assert t[0] == pytest.approx(lookup(image, gx, gy).mean() * y / total, rel=1e-5)
    row = lookup(image, k, np.full(400, y))
    assert s[0] == pytest.approx(lookup(image, k * x, np.full(400, y)).mean() * x / row.mean(), rel=1e-5)


def test_a_blend_is_the_warp_of_the_blended_densities():
    rng = np.random.default_rng(6)
    images = rng.uniform(0.1, 1, (2, 5, 7))
    warp = Warp(images)
    scaled = [image / _integral(image) for image in images]
    mixed = Warp((0.3 * scaled[0] + 0.7 * scaled[1])[None])
    x, y = rng.uniform(0, 1, (2, 100))
    blend = [(np.zeros(100, int), np.full(100, 0.3)), (np.ones(100, int), np.full(100, 0.7))]
    np.testing.assert_allclose(warp.inverse(blend, x, y), mixed.inverse(alone(0, 100), x, y), atol=1e-13)
    data = rng.uniform(-1, 1, (2, 3, 4, 4))
    apart = [np.stack([lookup(image, x, y) for image in one], axis=1) for one in data]
    np.testing.assert_allclose(lookup_blend(data, blend, x, y), 0.3 * apart[0] + 0.7 * apart[1], atol=1e-13)


def test_where_nothing_is_mapped():
    """Ends without density are left out; the inverse stays finite there."""
    image = np.zeros((5, 5))
    image[1:3, 2] = 1.0
    warp = Warp(image[None])
    s, t = np.array([0.0, 1, 0.5]), np.array([0.0, 1, 0.5])
    x, y = warp.forward(0, s, t)
    np.testing.assert_allclose(x, [0.25, 0.75, 0.5], atol=1e-9)
    np.testing.assert_allclose(y, [0.0, 0.75, 0.375], atol=1e-9)
    x, y = (g.reshape(-1) for g in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)))
    found = np.array(warp.inverse(alone(0, 81), x, y))
    assert ((found >= 0) & (found <= 1)).all()
    for bad in (np.zeros((2, 2)), np.full((2, 2), np.nan), np.full((2, 2), np.inf)):
        with pytest.raises(ValueError, match="integral"):
            Warp(bad[None])


def _integral(image: np.ndarray) -> float:
    cells = (len(image) - 1) * (image.shape[1] - 1)
    return float(np.trapezoid(np.trapezoid(image, axis=1), axis=0)) / cells
