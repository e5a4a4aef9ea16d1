"""How much light a model sends back at most, its reflectances at 1."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fitter.models import create
from fitter.models.base import ReflectanceModel
from fitter.models.registry import family_of
from fitter.spec import ModelSpec

COSINES = (1.0, 0.7, 0.3, 0.1, 0.03, 0.01)
#: From so many draws the albedo of a dear model is estimated, instead of by quadrature.
DRAWS = 4096


def made(
    spec: ModelSpec, values: Mapping[str, float], channels: Sequence[str] = ("value",)
) -> ReflectanceModel:
    """A model of these parameter values, the same in all its channels."""
    given: dict[str, Any] = dict(values)
    return create(spec, channels=channels, **given)


def largest_albedo(
    spec: ModelSpec, settings: Mapping[str, Mapping[str, float]], dear: bool
) -> tuple[float, str]:
    """The largest directional albedo (with what is transmitted) and where, over incidences and parameters.

    dear : a pair costs too much for quadrature over the hemisphere.
    """
    best, where = -math.inf, ""
    # Some are worst between their bounds.
    for values in (*settings.values(), _wider(spec, settings["defaults"])):
        for whole in reflectances(spec):
            model = made(spec, {**values, **whole})
            for mu in COSINES:
                found = _albedo(model, mu, dear)
                if found > best:
                    given = ", ".join(f"{key} {value:g}" for key, value in {**values, **whole}.items())
                    drawn = f", estimated from {DRAWS} draws" if dear else ""
                    best, where = found, f"cosine {mu:g}, {given}{drawn}"
    return best, where


def _wider(spec: ModelSpec, defaults: Mapping[str, float]) -> dict[str, float]:
    """The defaults with roughness, and whatever else is searched by order of magnitude, two and a half times
    as large."""
    found = dict(defaults)
    for p in family_of(spec).parameter_table(spec):
        if p.search == "log" and not p.linear:
            found[p.name] = min(2.5 * p.default, p.upper)
    return found


def reflectances(spec: ModelSpec) -> Iterator[dict[str, float]]:
    """Settings of the linear parameters: one scale at 1 and the others at 0, as scales add up; shares of
    it (F0, colours), which stop at 1, at either end."""
    table = [p for p in family_of(spec).parameter_table(spec) if p.linear]
    scales = [p.name for p in table if math.isinf(p.upper)]
    shares = [p.name for p in table if not math.isinf(p.upper)]
    for chosen in scales or [None]:
        ends = itertools.product((1.0, 0.0), repeat=len(shares))
        for values in itertools.islice(ends, 4):
            yield {**{s: float(s == chosen) for s in scales}, **dict(zip(shares, values, strict=True))}


def _albedo(model: ReflectanceModel, mu: float, dear: bool) -> float:
    wi = np.array([math.sqrt((1.0 - mu) * (1.0 + mu)), 0.0, mu])
    if dear:
        return float(model.sample(wi, DRAWS, seed=3).weight.mean())
    total = float(model.albedo(wi)[0])
    if type(model).transmits(model.spec):
        total += float(model.transmittance(wi)[0])
    return total
