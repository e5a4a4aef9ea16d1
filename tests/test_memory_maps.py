"""Compiled programs are forgotten when they take too many memory maps, and not before."""

from __future__ import annotations

from pathlib import Path

import jax
import pytest

from fitter.memory_maps import forget_when_many


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="only Linux counts memory maps")
def test_programs_are_forgotten_when_they_are_many() -> None:
    double = jax.jit(lambda x: 2 * x)
    double(1.0)
    assert double._cache_size() == 1
    assert not forget_when_many(share=1.0)
    assert double._cache_size() == 1
    assert forget_when_many(share=0.0)
    assert double._cache_size() == 0
    assert double(2.0) == 4.0
