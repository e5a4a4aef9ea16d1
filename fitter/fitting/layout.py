"""Layout: how the free parameters of a model lie in the vector that solvers see."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter import models
from fitter.errors import SpecError
from fitter.models.base import ReflectanceModel
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.spec import FitSpec, ModelSpec

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Layout:
    """Nonlinear parameters of one group of channels, hashable, so that it can key compiled programs.

    Solvers see the T *free* nonlinear parameters in their search coordinate: the logarithm where the
    parameter table says so. The K coefficients of the terms are apart, (K, C).
    """

    spec: ModelSpec
    free: tuple[str, ...]
    fixed: tuple[tuple[str, float], ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    logs: tuple[bool, ...]

    @property
    def family(self) -> type[ReflectanceModel]:
        return models.family_of(self.spec)

    def nonlinear(self, u: Array) -> dict[str, Array]:
        """Name -> value in the parameter's own unit, from search coordinates u (T,)."""
        found = {name: jnp.asarray(value, u.dtype) for name, value in self.fixed}
        for k, (name, log) in enumerate(zip(self.free, self.logs, strict=True)):
            found[name] = jnp.exp(u[k]) if log else u[k]
        return found

    def terms(self, u: Array, pair: Array) -> Array:
        """(K, n) terms at pairs (6, n)."""
        return jnp.stack(self.family.terms(self.spec, self.nonlinear(u), Pair(*pair)))

    @property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """Bounds (T,) in search coordinates."""
        return np.array(self.lower, float), np.array(self.upper, float)


def layout(fit: FitSpec) -> Layout:
    """The layout of a fit. Raises SpecError naming the parameter of a bad ``fixed`` or ``bounds``."""
    table = {p.name: p for p in models.parameter_table(fit.model)}
    nonlinear = [p for p in table.values() if not p.linear]
    for name, value in fit.fixed.items():
        p = _nonlinear(table, name, "fixed")
        if not p.lower <= value <= p.upper:
            raise SpecError(
                f"{name} can't be fixed at {value:g}: its range is {p.lower:g} to {p.upper:g}",
                code="bad-fixed", parameter=name, remedy="choose a value inside its range",
            )  # fmt: skip
    free: list[str] = []
    low: list[float] = []
    high: list[float] = []
    logs: list[bool] = []
    for name in fit.bounds:
        _nonlinear(table, name, "bounds")
        if name in fit.fixed:
            raise SpecError(
                f"{name} is both fixed and bounded", code="bad-bounds", parameter=name,
                remedy="leave out one of the two",
            )  # fmt: skip
    for p in nonlinear:
        if p.name in fit.fixed:
            continue
        lower, upper = fit.bounds.get(p.name, (p.lower, p.upper))
        if not p.lower <= lower < upper <= p.upper:
            raise SpecError(
                f"bounds {lower:g} to {upper:g} of {p.name} don't lie in {p.lower:g} to {p.upper:g}",
                code="bad-bounds", parameter=p.name, remedy="give lower < upper inside that range",
            )  # fmt: skip
        log = p.search == "log"
        free.append(p.name)
        logs.append(log)
        low.append(float(np.log(lower) if log else lower))
        high.append(float(np.log(upper) if log else upper))
    return Layout(
        fit.model, tuple(free), tuple(sorted(fit.fixed.items())), tuple(low), tuple(high), tuple(logs)
    )


def interchangeable(layout: Layout) -> list[list[int]] | None:
    """Positions in u of each lobe's own parameters, or None unless there are several lobes all alike."""
    count = layout.spec.lobes
    suffixes = [f"_{lobe + 1}" for lobe in range(count)]
    own = [[k for k, name in enumerate(layout.free) if name.endswith(suffix)] for suffix in suffixes]
    kinds = {
        tuple((layout.free[k].rpartition("_")[0], layout.lower[k], layout.upper[k]) for k in ks) for ks in own
    }
    return own if count > 1 and len(kinds) == 1 and own[0] else None


def order_lobes(layout: Layout, p: FloatArray) -> FloatArray:
    """The vector p with interchangeable lobes ordered from broad to narrow. Only labels change."""
    own, count, t = interchangeable(layout), layout.spec.lobes, len(layout.free)
    exponents = [k for k, name in enumerate(layout.free) if name.startswith("n_")]
    if own is None or len(exponents) != count:
        return p
    order = np.argsort(p[exponents], kind="stable")
    u = p[:t].copy()
    for place, lobe in enumerate(order):
        u[own[place]] = p[own[lobe]]
    first = int(layout.spec.diffuse == "lambert")
    b = p[t:].reshape(first + count, -1)
    return np.concatenate([u, b[:first].reshape(-1), b[first:][order].reshape(-1)])


def channel_groups(spec: ModelSpec, channels: int) -> list[list[int]]:
    """The channels that share their nonlinear parameters, and so are solved together."""
    every = list(range(channels))
    return [[c] for c in every] if per_channel(spec) else [every]


def per_channel(spec: ModelSpec) -> bool:
    """Whether each channel has nonlinear parameters of its own. Raises SpecError on a mixture."""
    table = [p for p in models.parameter_table(spec) if not p.linear]
    if spec.per_channel is None:
        return any(p.per_channel for p in table)
    names = {p.name for p in table}
    unknown = set(spec.per_channel) - names
    if unknown:
        raise SpecError(
            f"{spec.name} has no nonlinear parameter {sorted(unknown)[0]!r}", code="unknown-parameter",
            parameter="per_channel", remedy=f"its nonlinear parameters are {', '.join(sorted(names))}",
        )  # fmt: skip
    if spec.per_channel and set(spec.per_channel) != names:
        raise SpecError(
            "some nonlinear parameters per channel and others shared is not supported yet",
            code="mixed-per-channel", parameter="per_channel",
            remedy=f"name all of {', '.join(sorted(names))}, or none",
        )  # fmt: skip
    return bool(spec.per_channel)


def _nonlinear(table: Mapping[str, Parameter], name: str, where: str) -> Parameter:
    names = [p.name for p in table.values() if not p.linear]
    if name not in names:
        what = "enters linearly and is always fitted" if name in table else "is not a parameter of this model"
        raise SpecError(
            f"{name} {what}: {where} takes nonlinear parameters", code=f"bad-{where}", parameter=name,
            remedy=f"use {', '.join(names)}",
        )  # fmt: skip
    return table[name]
