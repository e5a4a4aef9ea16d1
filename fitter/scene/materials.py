"""Materials of a scene: fitted or inline models, evaluated by JAX, and raw tables, by their interpolant.

Directions are in the surface's own frame: ``l`` towards the light, ``v`` towards the viewer, (N, 3).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike, NDArray

from fitter.errors import FitterError
from fitter.models import ReflectanceModel
from fitter.models.base import cast, mixture_density
from fitter.models.lobes import mixture_pdf
from fitter.models.pair import Pair
from fitter.sampling import TableSampler
from fitter.table import Table

FloatArray = NDArray[np.float64]

#: Incidences that a raw table's densities are kept for, and the share of draws that are cosine-distributed,
#: so that whatever those miss is still met.
_INCIDENCES = 12
_COSINE = 0.25


class Drawn(NamedTuple):
    """Directions l (N, 3) drawn for v: weight (N, C) = f |cos| / pdf, 0 where lost; pdf (N,), 0 of ideal
    components; is_delta (N,)."""

    towards: Any
    weight: Any
    pdf: Any
    is_delta: Any


class Material(Protocol):
    """What the integrator asks of a material."""

    @property
    def transmits(self) -> bool: ...

    def value(self, l: Array, v: Array, /) -> Any:
        """f |cos theta_l| (N, C or 1)."""
        ...

    def pdf(self, l: Array, v: Array, /) -> Any:
        """Density (N,) of :meth:`draw`."""
        ...

    def draw(self, v: Array, rng: np.random.Generator, /) -> Drawn: ...


#: A kernel and its arguments.
Call = tuple[Any, tuple[Any, ...]]


@dataclasses.dataclass(frozen=True)
class ModelMaterial:
    """A reflectance model; ``off``, ``constants`` : what a plan makes of it (:mod:`fitter.scene.shading`)."""

    model: ReflectanceModel
    off: frozenset[str] = frozenset()
    constants: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def transmits(self) -> bool:
        return self.model.transmits(self.model.spec)

    @property
    def has_ideal(self) -> bool:
        """Whether part of what it sends back goes in one direction."""
        up = jnp.zeros(()), jnp.zeros(()), jnp.ones(())
        return bool(self.model.deltas(self.model.spec, self.model.values, *up))

    def value(self, l: Array, v: Array) -> Array:
        kernel, given = self.value_call(l, v)
        return kernel(*given)

    def pdf(self, l: Array, v: Array) -> Array:
        kernel, given = self.pdf_call(l, v)
        return kernel(*given)

    def draw(self, v: Array, rng: np.random.Generator) -> Drawn:
        kernel, given = self.draw_call(v, rng)
        return kernel(*given)

    def value_call(self, l: Array, v: Array) -> Call:
        """The kernel behind :meth:`value` and what it is called with."""
        return _value, (cast(self.model, l.dtype), self.off, dict(self.constants), l, v)

    def pdf_call(self, l: Array, v: Array) -> Call:
        """That behind :meth:`pdf`."""
        return mixture_density, (cast(self.model, l.dtype), v, l)

    def draw_call(self, v: Array, rng: np.random.Generator) -> Call:
        """That behind :meth:`draw`."""
        u = jnp.asarray(rng.random((len(v), 3), np.float64), v.dtype)
        # Rounded to float32 a number may be 1, which is no uniform number's value.
        u = jnp.minimum(u, 1.0 - float(jnp.finfo(v.dtype).epsneg))
        return _draw, (cast(self.model, v.dtype), v, u)


@eqx.filter_jit
def _value(
    model: ReflectanceModel, off: frozenset[str], constants: dict[str, Any], l: Array, v: Array
) -> Array:
    from fitter.scene.shading import value

    return value(model, off, constants, Pair.split(l, v)) * jnp.abs(l[:, 2:])


@eqx.filter_jit
def _draw(model: ReflectanceModel, v: Array, u: Array) -> Drawn:
    """One direction for each v: a lobe or ideal component chosen, then drawn from."""
    transmits = model.transmits(model.spec)
    lobes, shares, deltas = model.mixture(v[:, 0], v[:, 1], v[:, 2])
    ends = jnp.cumsum(jnp.stack([jnp.broadcast_to(s, v.shape[:1]) for s in shares]), axis=0)
    pick = jnp.minimum(jnp.sum(u[:, 2] >= ends, axis=0), len(shares) - 1)
    l = jnp.zeros_like(v).at[:, 2].set(1.0)
    for k, lobe in enumerate(lobes):
        start = ends[k - 1] if k else jnp.zeros_like(ends[0])
        width = ends[k] - start
        rest = jnp.clip((u[:, 2] - start) / jnp.where(width > 0, width, 1.0), 0.0, 1.0)
        three = jnp.concatenate([u[:, :2], rest[:, None]], axis=1)
        drawn = jax.vmap(lambda w, one, lobe=lobe: lobe.sample(w, one[None])[0])(v, three)
        l = jnp.where((pick == k)[:, None], drawn, l)
    pair = Pair.split(v, l)
    pdf = mixture_pdf(lobes, shares, pair, transmits)
    ok = (pdf > 0) & ((l[:, 2] != 0) if transmits else (l[:, 2] > 0) & (v[:, 2] > 0))
    weight = jnp.zeros((len(v), len(model.channels)), v.dtype)
    if lobes:
        # Of light from l to v: where f is not symmetric this is not what the draws are made for.
        found = model.value(Pair.split(l, v)) * (jnp.abs(l[:, 2]) / jnp.where(ok, pdf, 1.0))[:, None]
        weight = jnp.where(ok[:, None], found, weight)
    ideal = pick >= len(lobes)
    weight = jnp.where(ideal[:, None], 0.0, weight)
    eta = model.refractive_index(model.spec, model.values)
    for k, delta in enumerate(deltas, start=len(lobes)):
        chosen = pick == k
        direction = jnp.stack(jnp.broadcast_arrays(delta.x, delta.y, delta.z), axis=1)
        l = jnp.where(chosen[:, None], direction, l)
        share = jnp.broadcast_to(shares[k], v.shape[:1])
        # Radiance over the index squared is what refraction keeps.
        through = (direction[:, 2] * v[:, 2] < 0)[:, None]
        squeezed = jnp.where(v[:, 2:] > 0, 1.0 / (eta * eta), eta * eta)
        part = delta.weight * jnp.where(through, squeezed, 1.0) / jnp.where(share > 0, share, 1.0)[:, None]
        weight = jnp.where((chosen & (share > 0))[:, None], part, weight)
    return Drawn(l, weight, jnp.where(ideal, 0.0, jnp.where(ok, pdf, 0.0)), ideal)


@dataclasses.dataclass
class Extrapolation:
    """What was asked of a table, and what of that lies outside the measured domain."""

    asked: int = 0
    outside: int = 0
    clamped: int = 0
    theta_l_deg: tuple[float, float] | None = None
    theta_v_deg: tuple[float, float] | None = None

    def add(self, l: FloatArray, v: FloatArray, outside: NDArray[np.bool_], clamped: int) -> None:
        self.asked += len(l)
        self.outside += int(outside.sum())
        self.clamped += clamped
        if outside.any():
            self.theta_l_deg = _widened(self.theta_l_deg, l[outside])
            self.theta_v_deg = _widened(self.theta_v_deg, v[outside])

    def to_dict(self) -> dict[str, Any]:
        asked = max(self.asked, 1)
        return {
            "evaluations": self.asked, "extrapolated_share": self.outside / asked,
            "theta_light_deg": self.theta_l_deg, "theta_view_deg": self.theta_v_deg,
            "negative_taken_as_zero_share": self.clamped / asked,
        }  # fmt: skip


def _widened(known: tuple[float, float] | None, w: FloatArray) -> tuple[float, float]:
    theta = np.rad2deg(np.arccos(np.clip(w[:, 2], -1.0, 1.0)))
    low, high = float(theta.min()), float(theta.max())
    return (low, high) if known is None else (min(low, known[0]), max(high, known[1]))


class TableMaterial:
    """A raw table: f is its interpolant, negative values taken as 0; outside the measured domain its nearest,
    counted in ``extrapolation``. Directions are drawn by :class:`fitter.TableSampler` at a few incidences."""

    transmits = False

    def __init__(self, table: Table, columns: NDArray[np.intp]) -> None:
        self._table = table
        self._columns = columns
        self.extrapolation = Extrapolation()
        self.note: str | None = None
        angles = (np.arange(_INCIDENCES) + 0.5) * (0.5 * np.pi / _INCIDENCES)
        self._incidences = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
        self._sampler: TableSampler | None = None
        self._usable: NDArray[np.bool_] | None = None

    @property
    def single(self) -> bool:
        """Whether one column serves all channels of the scene."""
        return len(self._columns) == 1

    def _ready(self) -> NDArray[np.bool_]:
        """(K,) the incidences that can be drawn at; their envelopes are made when first needed."""
        if self._usable is None:
            usable = np.zeros(_INCIDENCES, bool)
            try:
                self._sampler = TableSampler(self._table)
                for k, wi in enumerate(self._incidences):
                    usable[k] = self._sampler.envelope(wi, allow_extrapolated=True).integral > 0
            except FitterError as error:
                usable[:] = False
                self.note = f"directions are drawn by the cosine only: {error.message}"
            self._usable = usable
        return self._usable

    def value(self, towards: ArrayLike, viewer: ArrayLike) -> FloatArray:
        l, v = _unit(towards), _unit(viewer)
        found = np.zeros((len(l), len(self._columns)))
        lit = (l[:, 2] > 0) & (v[:, 2] > 0)
        if lit.any():
            values, outside = self._table.evaluate(l[lit], v[lit])
            values = np.nan_to_num(values[:, self._columns], nan=0.0)
            negative = values < 0
            self.extrapolation.add(l[lit], v[lit], outside, int(negative.any(axis=1).sum()))
            found[lit] = np.where(negative, 0.0, values) * l[lit, 2:]
        return found

    def pdf(self, towards: ArrayLike, viewer: ArrayLike) -> FloatArray:
        l, v = _unit(towards), _unit(viewer)
        cosine = np.maximum(l[:, 2], 0.0) / np.pi
        which = self._which(v)
        density = np.where(which >= 0, _COSINE, 1.0) * cosine
        for k in np.unique(which[which >= 0]).tolist():
            lanes = np.flatnonzero((which == k) & (l[:, 2] > 0))
            if len(lanes) and self._sampler is not None:
                turned = _turn(l[lanes], v[lanes], -1)
                own = self._sampler.pdf(self._incidences[k], turned, allow_extrapolated=True)
                density[lanes] += (1.0 - _COSINE) * own
        return np.where(v[:, 2] > 0, density, 0.0)

    def draw(self, viewer: ArrayLike, rng: np.random.Generator) -> Drawn:
        w = _unit(viewer)
        n = len(w)
        u = rng.random((3, n))
        r, phi = np.sqrt(u[0]), 2 * np.pi * u[1]
        l = np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1.0 - u[0])], axis=1)
        which = np.where(u[2] < _COSINE, -1, self._which(w))
        for k in np.unique(which[which >= 0]).tolist():
            lanes = np.flatnonzero(which == k)
            if self._sampler is not None:
                seed = int(rng.integers(2**62))
                drawn = self._sampler.sample(self._incidences[k], len(lanes), seed, allow_extrapolated=True)
                l[lanes] = _turn(drawn.wo, w[lanes], 1)
        pdf = self.pdf(l, w)
        ok = pdf > 0
        weight = np.where(ok[:, None], self.value(l, w) / np.where(ok, pdf, 1.0)[:, None], 0.0)
        return Drawn(l, weight, pdf, np.zeros(n, bool))

    def _which(self, v: FloatArray) -> NDArray[np.intp]:
        """(N,) the incidence whose density is used for v, -1 for none."""
        theta = np.arccos(np.clip(v[:, 2], -1.0, 1.0))
        k = np.clip((theta / (0.5 * np.pi) * _INCIDENCES).astype(np.intp), 0, _INCIDENCES - 1)
        return np.where((v[:, 2] > 0) & self._ready()[k], k, -1)


def _unit(w: ArrayLike) -> FloatArray:
    wide = np.asarray(w, np.float64)
    return wide / np.linalg.norm(wide, axis=-1, keepdims=True)


def _turn(w: FloatArray, v: FloatArray, sign: int) -> FloatArray:
    """w turned about the normal by the azimuth of v (sign 1) or back (-1)."""
    length = np.hypot(v[:, 0], v[:, 1])
    safe = np.where(length > 0, length, 1.0)
    c, s = np.where(length > 0, v[:, 0] / safe, 1.0), sign * np.where(length > 0, v[:, 1] / safe, 0.0)
    return np.stack([c * w[:, 0] - s * w[:, 1], s * w[:, 0] + c * w[:, 1], w[:, 2]], axis=1)
