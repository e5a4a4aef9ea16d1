"""The cube root that a pass is made of, against NumPy's."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter.fitting import cube_root

NORMAL = st.floats(2.3e-308, 1.7e308)


@given(st.lists(NORMAL, min_size=1, max_size=8))
def test_inverse(values):
    x = np.array(values)
    np.testing.assert_allclose(cube_root.inverse(jnp.asarray(x)), 1.0 / np.cbrt(x), rtol=1e-15)


@given(st.lists(st.floats(1e-300, 1.7e308), min_size=1, max_size=8))
def test_root(values):
    x = np.array(values)
    np.testing.assert_allclose(cube_root.of_positive(x), np.cbrt(x), rtol=2e-15)
    mantissa = np.linspace(1.0, 8.0, 10_001)
    np.testing.assert_allclose(cube_root.of_positive(mantissa), np.cbrt(mantissa), rtol=1e-15)


def test_what_has_no_weight_gets_none():
    given = np.array([0.0, 5e-324, 1e-308, -5e-324, -1e-9, -0.5, -1.0])
    found = cube_root.of_positive(given)
    assert found[0] == 0.0
    assert (np.abs(found) < 1e-90).all()


@pytest.mark.parametrize("x", [1e-6, 1.0, 7.9, 3e11])
def test_derivatives(x):
    first, second = jax.grad(cube_root.inverse), jax.grad(jax.grad(cube_root.inverse))
    assert float(first(x)) == pytest.approx(-(x ** (-4 / 3)) / 3, rel=1e-14)
    assert float(second(x)) == pytest.approx(4 / 9 * x ** (-7 / 3), rel=1e-14)
