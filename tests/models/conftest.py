"""Random draws of each model's parameters: plausible ones, and ones on the bounds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fitter import models
from fitter.models import Parameter


def draw(name: str, seed: int, channels: int = 3, *, hard: bool = False) -> models.ReflectanceModel:
    """A random model inside its bounds, of roughness and exponents as measured materials have.

    hard : every parameter has an even chance of lying on one of its bounds instead.
    """
    rng = np.random.default_rng(seed)
    values: dict[str, np.ndarray] = {}
    for p in models.parameter_table(name):
        size = channels if p.linear or p.per_channel else 1
        value = _plausible(p, rng, size)
        if hard:
            bound = np.where(rng.random(size) < 0.5, p.lower, min(p.upper, 1.0 if p.linear else np.inf))
            value = np.where(rng.random(size) < 0.5, bound, value)
        values[p.name] = value if size > 1 else value[0]
    return models.create(name, channels=[f"c{k}" for k in range(channels)], **values)


def _plausible(p: Parameter, rng: np.random.Generator, size: int) -> np.ndarray:
    if p.search == "log":
        exponent = p.upper > 1e3
        low, high = max(p.lower, 1.0 if exponent else 0.05), min(p.upper, 200.0 if exponent else 0.9)
        return np.exp(rng.uniform(np.log(low), np.log(high), size))
    if np.isinf(p.upper):
        return rng.uniform(0.05, 0.8, size)
    found = rng.uniform(p.lower, p.upper, size)
    # An interface between like media is refused.
    return np.where(np.abs(found - 1.0) < 2e-3, 1.01, found) if p.name == "eta" else found


@pytest.fixture
def random_model() -> Callable[..., models.ReflectanceModel]:
    return draw
