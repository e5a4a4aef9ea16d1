"""Choosing with given probabilities: the table holds them exactly, and nothing impossible is chosen."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from fitter.sampling.alias import AliasTable


@given(
    arrays.arrays(
        np.float64, st.integers(1, 60), elements=st.one_of(st.just(0.0), st.floats(1e-30, 1e6))
    ).filter(lambda w: w.sum() > 0)
)
def test_the_boxes_hold_the_probabilities(weights: np.ndarray) -> None:
    table = AliasTable(weights)
    count = len(weights)
    share, alias = table._share, table._alias
    held = (share + np.bincount(alias, 1 - share, count)) / count
    np.testing.assert_allclose(held, weights / weights.sum(), atol=1e-13)
    assert not held[weights == 0].any()
    # Every box at both of its ends and where its items meet.
    uniform = ((np.arange(count)[:, None] + np.array([0.0, 0.5, 1 - 1e-12])) / count).reshape(-1)
    assert (weights[table.choose(uniform)] > 0).all()
