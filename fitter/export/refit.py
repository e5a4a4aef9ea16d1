"""Refits: the parameters of another program's own model that come nearest to a model or a table of ours.

Where a target has no such model, what it gets is not ours under its name but its own model fitted to ours:
least squares of cube roots, the metric that fits take where nothing is known of the noise, at the pairs of
:func:`fitter.export.fidelity.compared_pairs`, from several starts. The residual is reported beside ours.
"""

from __future__ import annotations

import importlib
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.export.fidelity import compared_pairs
from fitter.export.subject import Subject
from fitter.formats.registry import Loss

FloatArray = NDArray[np.float64]
#: Parameters by name, (C,) or (), and the components of both directions -> f_r (M, C) in 1/sr.
Evaluate = Callable[[Mapping[str, FloatArray], FloatArray, FloatArray], FloatArray]

_PAIRS = 2000


@dataclass(frozen=True)
class Unknown:
    """A parameter of the target's model: its range, where the search starts, one for each channel or one in
    all, and whether it is searched by its logarithm."""

    name: str
    lower: float
    upper: float
    starts: tuple[float, ...]
    per_channel: bool = False
    log: bool = False


@dataclass(frozen=True)
class Refit:
    """Parameters, (C,) or (), and the relative rms difference from the subject: of f + 1 % of its median."""

    model: str
    values: Mapping[str, FloatArray]
    residual: float
    subject: Subject

    def residuals(self) -> dict[str, Any]:
        """JSON-ready: the target's model and its distance from the source, beside ours from the table."""
        fit = self.subject.fit
        return {
            "model": self.model,
            "parameters": {name: np.asarray(value).tolist() for name, value in self.values.items()},
            "refit": self.residual,
            "ours": None if fit is None else float(fit.metrics["relative_rmse"]),
        }

    def sentence(self) -> str:
        """The residuals in words, for the head of a file and the notes."""
        ours = self.residuals()["ours"]
        what = "the table" if self.subject.table is not None else "our model"
        beside = "" if ours is None else f"; our fit differs from its table by {ours:.1%}"
        by = f"{self.residual:.1%} (relative rms)"
        return f"A refit as {self.model}, which differs from {what} by {by}{beside}."

    def note(self) -> Loss:
        return Loss("refit", self.sentence())


def refit(subject: Subject, model: str, unknowns: Sequence[Unknown], evaluate: Evaluate) -> Refit:
    """The nearest parameters of ``model``. Raises SpecError for channels that are neither one nor three."""
    count = len(subject.channels)
    if count not in (1, 3):
        raise SpecError(
            f"the target has one channel or three, and this has {count}", code="export-channels",
            parameter="channels", remedy="choose three of them with --channels",
        )  # fmt: skip
    # Takes a quarter of a second, and only here.
    optimize: Any = importlib.import_module("scipy.optimize")
    wi, wo = compared_pairs(subject, _PAIRS)
    ours, outside = subject.evaluate(wi, wo)
    kept = ~outside & np.isfinite(ours).all(axis=1) & (ours >= 0).all(axis=1)
    wi, wo, ours = wi[kept], wo[kept], ours[kept]
    roots = np.cbrt(ours)
    sizes = [count if u.per_channel else 1 for u in unknowns]
    low, high = (_stretched(unknowns, sizes, end) for end in ("lower", "upper"))

    def values(x: FloatArray) -> dict[str, FloatArray]:
        parts = np.split(x, np.cumsum(sizes)[:-1])
        return {
            u.name: (np.exp(p) if u.log else p) if u.per_channel else (np.exp(p[0]) if u.log else p[0])
            for u, p in zip(unknowns, parts, strict=True)
        }

    def difference(x: FloatArray) -> FloatArray:
        return (np.cbrt(np.maximum(evaluate(values(x), wi, wo), 0.0)) - roots).reshape(-1)

    best: Any = None
    for start in itertools.product(*(u.starts for u in unknowns)):
        x = np.repeat([np.log(s) if u.log else s for u, s in zip(unknowns, start, strict=True)], sizes)
        found = optimize.least_squares(
            difference, x, bounds=(low, high), x_scale=np.maximum(high - low, 1e-3)
        )
        best = found if best is None or found.cost < best.cost else best
    chosen = values(np.asarray(best.x))
    floor = 0.01 * np.median(ours, axis=0)
    relative = (evaluate(chosen, wi, wo) - ours) / (ours + np.maximum(floor, 1e-12))
    return Refit(model, chosen, float(np.sqrt((relative**2).mean())), subject)


def of_ours(model: str, channels: int) -> Evaluate:
    """One of this library's models as a function of its parameters, one compiled program."""
    import jax
    import jax.numpy as jnp

    from fitter import models
    from fitter.models.pair import Pair

    kind, spec = models.family_of(models.create(model).spec), models.create(model).spec
    names = tuple(f"c{k}" for k in range(channels))

    @jax.jit
    def value(values: dict[str, Any], wi: Any, wo: Any) -> Any:
        wide = {p.name: jnp.broadcast_to(values[p.name], (channels,)) if p.linear else values[p.name]
                for p in kind.parameter_table(spec)}  # fmt: skip
        return kind(spec=spec, channels=names, values=wide).value(Pair.split(wi, wo))

    def evaluate(values: Mapping[str, FloatArray], wi: FloatArray, wo: FloatArray) -> FloatArray:
        return np.asarray(value({k: np.asarray(v) for k, v in values.items()}, wi, wo))

    return evaluate


def _stretched(unknowns: Sequence[Unknown], sizes: Sequence[int], end: str) -> FloatArray:
    ends = [float(getattr(u, end)) for u in unknowns]
    return np.repeat([np.log(e) if u.log else e for u, e in zip(unknowns, ends, strict=True)], sizes)
