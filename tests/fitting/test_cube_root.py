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


@pytest.mark.parametrize("x", [1e-6, 1.0, 7.9, 3e11])
def test_derivatives(x):
    first, second = jax.grad(cube_root.inverse), jax.grad(jax.grad(cube_root.inverse))
    assert float(first(x)) == pytest.approx(-(x ** (-4 / 3)) / 3, rel=1e-14)
    assert float(second(x)) == pytest.approx(4 / 9 * x ** (-7 / 3), rel=1e-14)
