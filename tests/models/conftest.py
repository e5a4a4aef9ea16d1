"""A plausible random draw of each model's parameters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fitter import models


def draw(name: str, seed: int, channels: int = 3) -> models.ReflectanceModel:
    """A random model inside its bounds, of roughness and exponents as measured materials have."""
    rng = np.random.default_rng(seed)
    values: dict[str, np.ndarray] = {}
    for p in models.parameter_table(name):
        size = channels if p.linear or p.per_channel else ()
        if p.search == "log":
            low, high = max(p.lower, 0.02), min(p.upper, 300.0 if p.name.startswith("n") else 0.9)
            values[p.name] = np.exp(rng.uniform(np.log(low), np.log(high), size))
        elif np.isinf(p.upper):
            values[p.name] = rng.uniform(0.0, 0.8, size)
        else:
            values[p.name] = rng.uniform(p.lower, p.upper, size)
    return models.create(name, channels=[f"c{k}" for k in range(channels)], **values)


@pytest.fixture
def random_model() -> Callable[..., models.ReflectanceModel]:
    return draw
