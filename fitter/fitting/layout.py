"""Layout: how the free parameters of a model lie in the vector that solvers see."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from fitter import models
from fitter.errors import SpecError
from fitter.fitting import rows
from fitter.models.base import SeparableModel
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.spec import FAMILIES, FitSpec, ModelSpec

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class Layout:
    """Parameters of one group of channels, hashable, so that it can key compiled programs.

    ``free`` names the F free nonlinear parameters. Solvers see them as u (T,), in their search coordinate
    (the logarithm where the parameter table says so): one entry for a parameter that the channels of the
    group share, C neighbours for one that each channel has for itself (``own``).

    Behind u lies the inner vector (M, C): the coefficients of the terms where they are free, M = K, and
    otherwise the linear parameters that they are functions of.
    """

    spec: ModelSpec
    free: tuple[str, ...]
    fixed: tuple[tuple[str, float], ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    logs: tuple[bool, ...]
    own: tuple[bool, ...]
    #: Channels of the group; 1 where no parameter is any channel's own, since nothing depends on it then.
    channels: int = 1

    @property
    def family(self) -> type[SeparableModel]:
        return _separable(self.spec)

    @property
    def mixed(self) -> bool:
        """Whether some parameters belong to single channels of the group."""
        return any(self.own)

    @property
    def coefficients_are_free(self) -> bool:
        return self.family.coefficients_are_free(self.spec)

    @functools.cached_property
    def linear(self) -> tuple[Parameter, ...]:
        return tuple(p for p in self.family.parameter_table(self.spec) if p.linear)

    @functools.cached_property
    def entries(self) -> tuple[tuple[int, int | None], ...]:
        """Per entry of u its position in ``free``, and its channel in the group or None where shared."""
        return tuple(
            (k, c) for k, own in enumerate(self.own) for c in (range(self.channels) if own else (None,))
        )

    @functools.cached_property
    def where(self) -> IntArray:
        """(C, F) positions in u of each channel's parameters."""
        index = {entry: position for position, entry in enumerate(self.entries)}
        entries = [
            [index[k, c if own else None] for k, own in enumerate(self.own)] for c in range(self.channels)
        ]
        return np.array(entries, np.intp).reshape(self.channels, len(self.free))

    def positions(self, size: int, channels: int) -> IntArray:
        """(C, F + M) positions of each channel's own entries in the vector p = [u, inner (M, C) flattened] of
        that size."""
        inner = np.arange(len(self.entries), size).reshape(-1, channels).T
        own = self.where if self.mixed else np.broadcast_to(self.where[0], (channels, len(self.free)))
        return np.concatenate([own, inner], axis=1)

    @property
    def alone(self) -> Layout:
        """The layout of a single channel of the group."""
        return dataclasses.replace(self, own=(False,) * len(self.free), channels=1)

    @property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """Bounds (T,) in search coordinates."""
        names = [k for k, _ in self.entries]
        return np.array(self.lower, float)[names], np.array(self.upper, float)[names]

    @property
    def inner_box(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of a channel's linear parameters (L,), where the coefficients are not free."""
        return np.array([p.lower for p in self.linear]), np.array([p.upper for p in self.linear])

    def nonlinear(self, u: Array) -> dict[str, Array]:
        """Name -> value in the parameter's own unit, () or (C,), from search coordinates u (T,)."""
        found = {name: jnp.asarray(value, u.dtype) for name, value in self.fixed}
        for k, (name, log) in enumerate(zip(self.free, self.logs, strict=True)):
            value = u[self.where[:, k]] if self.own[k] else u[self.where[0, k]]
            found[name] = jnp.exp(value) if log else value
        return found

    def search_vector(self, values: Mapping[str, FloatArray], group: Sequence[int]) -> FloatArray:
        """u (T,) of the channels ``group`` from values by name, () where shared, else one of each channel."""
        u = np.empty(len(self.entries))
        for entry, (k, own) in enumerate(self.entries):
            value = values[self.free[k]]
            number = float(value[group[own or 0]] if np.ndim(value) else value)
            u[entry] = np.log(number) if self.logs[k] else number
        return u

    def terms(self, u: Array, pair: Array) -> Array:
        """Terms at pairs (6, n): (K, n), or (C, K, n) where channels have parameters of their own.

        Pseudo-samples of a reduction (:mod:`fitter.fitting.reduction`) have J (6 + K) rows instead: J
        reference pairs, each with the weights of its K terms, which are added up.
        """
        nonlinear = self.nonlinear(u)
        if not self.mixed:
            terms = rows.stacked(self.family.terms(self.spec, nonlinear, Pair(*pair[:6])))
            if len(pair) == 6:
                return terms
            width = 6 + len(terms)
            total = terms * pair[6:width]
            for start in range(width, len(pair), width):
                reference = Pair(*pair[start : start + 6])
                terms = rows.stacked(self.family.terms(self.spec, nonlinear, reference))
                total = total + terms * pair[start + 6 : start + width]
            return total
        wide = Pair(*(component[:, None] for component in pair))
        found = self.family.terms(self.spec, nonlinear, wide)
        shape = (pair.shape[1], self.channels)
        return jnp.stack([jnp.broadcast_to(term, shape).T for term in found], axis=1)

    def coefficients(self, u: Array, inner: Array) -> Array:
        """The coefficients (K, C) that the inner vector (M, C) stands for."""
        if self.coefficients_are_free:
            return inner
        linear = {p.name: row for p, row in zip(self.linear, inner, strict=True)}
        found = self.family.coefficients(self.spec, linear, self.nonlinear(u))
        return jnp.stack([jnp.broadcast_to(b, inner.shape[1:]) for b in found])

    def linear_values(self, u: Array, inner: Array) -> dict[str, Array]:
        """The linear parameters, (C,) each, that the inner vector (M, C) stands for."""
        if self.coefficients_are_free:
            return self.family.linear_from(self.spec, list(inner), self.nonlinear(u))
        return {p.name: row for p, row in zip(self.linear, inner, strict=True)}


def layout(fit: FitSpec, channels: int = 1) -> Layout:
    """The layout of each group (:func:`channel_groups`) of a fit of a table with this many channels.

    Raises SpecError naming the parameter of a bad ``fixed``, ``bounds`` or ``per_channel``, or the model
    where it can't be fitted.
    """
    table = {p.name: p for p in _separable(fit.model).parameter_table(fit.model)}
    each = _per_channel(fit.model, table)
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
        lower, upper = fit.bounds.get(p.name, p.searched)
        log = p.search == "log"
        if not p.lower <= lower < upper <= p.upper or (log and lower <= 0):
            raise SpecError(
                f"bounds {lower:g} to {upper:g} of {p.name} don't lie in {p.lower:g} to {p.upper:g}",
                code="bad-bounds", parameter=p.name,
                remedy=f"give {'0 < ' if log else ''}lower < upper inside that range",
            )  # fmt: skip
        free.append(p.name)
        logs.append(log)
        low.append(float(np.log(lower) if log else lower))
        high.append(float(np.log(upper) if log else upper))
    own = tuple(name in each for name in free)
    # A channel whose parameters are all its own is a group by itself.
    mixed = channels > 1 and any(own) and not all(own)
    return Layout(
        fit.model, tuple(free), tuple(sorted(fit.fixed.items())), tuple(low), tuple(high), tuple(logs),
        own if mixed else (False,) * len(free), channels if mixed else 1,
    )  # fmt: skip


def channel_groups(fit: FitSpec, channels: int) -> list[list[int]]:
    """The channels that share nonlinear parameters, and so are solved together."""
    table = {p.name: p for p in _separable(fit.model).parameter_table(fit.model)}
    each = _per_channel(fit.model, table)
    free = [p.name for p in table.values() if not p.linear and p.name not in fit.fixed]
    every = list(range(channels))
    return [[c] for c in every] if free and each.issuperset(free) else [every]


def _separable(spec: ModelSpec) -> type[SeparableModel]:
    kind = models.family_of(spec)
    if not issubclass(kind, SeparableModel):
        raise SpecError(
            f"{spec.name} can be evaluated and sampled, not fitted", code="not-fitted", parameter="model",
            remedy=f"fit one of {', '.join(FAMILIES)}",
        )  # fmt: skip
    return kind


def _per_channel(spec: ModelSpec, table: Mapping[str, Parameter]) -> frozenset[str]:
    """The nonlinear parameters that each channel has for itself. Raises SpecError on an unknown name."""
    names = [p.name for p in table.values() if not p.linear]
    if spec.per_channel is None:
        return frozenset(name for name in names if table[name].per_channel)
    unknown = sorted(set(spec.per_channel) - set(names))
    if unknown:
        raise SpecError(
            f"{spec.name} has no nonlinear parameter {unknown[0]!r}", code="unknown-parameter",
            parameter="per_channel", remedy=f"its nonlinear parameters are {', '.join(sorted(names))}",
        )  # fmt: skip
    return frozenset(spec.per_channel)


def _nonlinear(table: Mapping[str, Parameter], name: str, where: str) -> Parameter:
    names = [p.name for p in table.values() if not p.linear]
    if name not in names:
        what = "enters linearly and is always fitted" if name in table else "is not a parameter of this model"
        raise SpecError(
            f"{name} {what}: {where} takes nonlinear parameters", code=f"bad-{where}", parameter=name,
            remedy=f"use {', '.join(names)}",
        )  # fmt: skip
    return table[name]
