"""The verbs every reflectance model has: evaluate, sample, pdf, albedo."""

from __future__ import annotations

import abc
import functools
import operator
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from fitter.errors import SpecError
from fitter.models import albedo as _albedo
from fitter.models.lobes import Delta, Lobe, OneSided, mixture_pdf, sample_mixture
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.models.span import Span
from fitter.sampling.samples import Samples
from fitter.spec import ModelSpec

#: The smallest share of draws any component of a model gets, so that no weight is without bound
#: where a component that looks weak on average is the strong one.
SMALLEST_SHARE = 0.1


class ReflectanceModel(eqx.Module):
    """A fitted or hand-made model: an immutable pytree of parameter values, (C,) per channel or () shared.

    A family is a subclass that says its parameter table, its value on a pair of directions, its lobes for
    sampling and its ideal (delta) components if it has any.
    """

    spec: ModelSpec = eqx.field(static=True)
    channels: tuple[str, ...] = eqx.field(static=True)
    values: dict[str, Array]

    family: ClassVar[str]
    #: What float32 may differ from float64 relatively, beside the rounding of its inputs.
    float32_error: ClassVar[float] = 1e-5

    # What a family declares -------------------------------------------------------------------------

    @staticmethod
    @abc.abstractmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        """Its parameters, linear ones first."""

    @abc.abstractmethod
    def value(self, p: Pair) -> Array:
        """f of a pair of components: shape (..., C), 1/sr; 0 below the horizon unless it transmits."""

    @staticmethod
    @abc.abstractmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        """The lobes to draw from, each with its unnormalised share (): about the light it carries."""

    @staticmethod
    def deltas(
        spec: ModelSpec, values: Mapping[str, Array], x: Array, y: Array, z: Array
    ) -> tuple[Delta, ...]:
        """The ideal components for incidences (x, y, z), each of the shape (...): none unless it says so."""
        del spec, values, x, y, z
        return ()

    @staticmethod
    def transmits(spec: ModelSpec) -> bool:
        """Whether light also leaves on the other side of the surface."""
        del spec
        return False

    @staticmethod
    def refractive_index(spec: ModelSpec, values: Mapping[str, Array]) -> Array:
        """Index below the surface over that above, () or (C,): tells the quadrature where light goes."""
        del spec, values
        return jnp.ones(())

    @staticmethod
    def reciprocal(spec: ModelSpec) -> bool:
        """Whether f(wi, wo) = f(wo, wi)."""
        del spec
        return True

    @staticmethod
    def isotropic(spec: ModelSpec) -> bool:
        """Whether turning the sample about its normal changes nothing."""
        return not spec.anisotropic

    # What every family has --------------------------------------------------------------------------

    @property
    def table(self) -> tuple[Parameter, ...]:
        return type(self).parameter_table(self.spec)

    @property
    def linear(self) -> dict[str, Array]:
        return {p.name: self.values[p.name] for p in self.table if p.linear}

    @property
    def nonlinear(self) -> dict[str, Array]:
        return {p.name: self.values[p.name] for p in self.table if not p.linear}

    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> Array:
        """f_r without the cosine, (..., C) in 1/sr, of unit vectors wi, wo (..., 3) that broadcast.

        0 where either direction is not above the horizon, unless the model transmits; ideal (delta)
        components are not part of it. The result has the dtype of the directions.
        """
        wi, wo = _directions(wi, wo)
        return _evaluate(cast(self, jnp.result_type(wi, wo)), wi, wo)

    def pdf(self, wi: ArrayLike, wo: ArrayLike) -> Array:
        """Density (...,) of :meth:`sample` drawing wo given wi, per unit solid angle of the whole sphere.

        Its integral over the upper hemisphere (the sphere, for models that transmit) is 1 less the share
        of draws lost below the horizon and of ideal components, which have no density.
        """
        wi, wo = _directions(wi, wo)
        return mixture_density(cast(self, jnp.result_type(wi, wo)), wi, wo)

    def albedo(self, wi: ArrayLike) -> Array:
        """Directional-hemispherical reflectance (..., C) by quadrature (:mod:`fitter.models.albedo`),
        ideal reflection included."""
        return self._integral(wi, reflected=True)

    def transmittance(self, wi: ArrayLike) -> Array:
        """Directional-hemispherical transmittance (..., C), ideal refraction included."""
        return self._integral(wi, reflected=False)

    def _integral(self, wi: ArrayLike, *, reflected: bool) -> Array:
        directions = jnp.asarray(wi, float)
        if directions.shape[-1:] != (3,):
            raise _shape_error("wi", directions.shape)
        flat = directions.reshape(-1, 3)
        found = [_albedo_one(self, one, reflected) for one in flat]
        return jnp.stack(found).reshape(*directions.shape[:-1], len(self.channels))

    def sample(self, wi: ArrayLike, n: int, *, seed: int | Array) -> Samples:
        """``n`` directions wo for one incidence wi (3,), drawn in its dtype; the same seed gives the same
        draws."""
        direction = jnp.asarray(wi)
        if not jnp.issubdtype(direction.dtype, jnp.floating):
            direction = direction.astype(float)
        if direction.shape != (3,):
            raise _shape_error("wi", direction.shape, "(3,)")
        if not 0 < n <= 100_000_000:
            raise SpecError(
                f"n is {n}", code="bad-sample-count", parameter="n", remedy="ask for 1 to 1e8 draws at a time"
            )
        if not bool(direction[2] > 0) and not (type(self).transmits(self.spec) and bool(direction[2] < 0)):
            raise SpecError(
                "wi is below the horizon", code="below-horizon", parameter="wi",
                remedy="directions point away from the surface: wi needs a positive z",
            )  # fmt: skip
        key = jax.random.key(seed) if isinstance(seed, int | np.integer) else seed
        # Sizes rounded up to a power of two: callers with any n share a few compiled programs.
        size = max(1024, 1 << (n - 1).bit_length())
        drawn = _sample(cast(self, direction.dtype), direction, size, key)
        wo, pdf, weight, valid, is_delta = (np.asarray(part)[:n] for part in drawn)
        return Samples(
            wo=wo, pdf=pdf, weight=weight, valid=valid, is_delta=is_delta, acceptance=1.0,
            seed=int(seed) if isinstance(seed, int | np.integer) else None,
        )  # fmt: skip

    def mixture(self, x: Array, y: Array, z: Array) -> tuple[list[Lobe], list[Array], tuple[Delta, ...]]:
        """The lobes, their shares and the ideal components for incidences (x, y, z), (...) each.

        Shares are those of lobes first, then of ideal components; they sum to 1. A lobe has at least
        SMALLEST_SHARE / count of what is left to lobes, an ideal component exactly its part.
        """
        found = type(self).lobes(self.spec, self.values)
        deltas = type(self).deltas(self.spec, self.values, x, y, z)
        drawn = [z > 0 if isinstance(lobe, OneSided) else jnp.ones_like(z, bool) for lobe, _ in found]
        strengths = [jnp.where(on, jnp.maximum(s, 0.0), 0.0) for (_, s), on in zip(found, drawn, strict=True)]
        ideal = [jnp.maximum(delta.share, 0.0) for delta in deltas]
        total = sum([*strengths, *ideal], start=jnp.zeros_like(z))
        safe = jnp.where(total > 0, total, 1.0)
        parts = [jnp.where(total > 0, share / safe, 1.0 / (len(found) + len(ideal))) for share in strengths]
        parts_ideal = [jnp.where(total > 0, share / safe, 1.0 / (len(found) + len(ideal))) for share in ideal]
        if found:
            # What lobes have in common, spread so that none is starved.
            together = sum(parts, start=jnp.zeros_like(z))
            count = jnp.maximum(sum(drawn, start=jnp.zeros_like(z)), 1.0)
            parts = [
                (1 - SMALLEST_SHARE) * p + SMALLEST_SHARE * jnp.where(on, together / count, 0.0)
                for p, on in zip(parts, drawn, strict=True)
            ]
        return [lobe for lobe, _ in found], [*parts, *parts_ideal], deltas

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready: what :func:`fitter.models.from_dict` reads back."""
        return {
            "spec": self.spec.model_dump(mode="json"),
            "name": self.spec.name,
            "channels": list(self.channels),
            "values": {name: np.asarray(v).tolist() for name, v in self.values.items()},
        }


class SeparableModel(ReflectanceModel):
    """A model that is a sum of terms with non-negative coefficients, which is what can be fitted:

    f_c(wi, wo) = sum_k coefficient_k(linear_c, nonlinear_c) term_k(nonlinear_c; wi, wo)
    """

    @staticmethod
    @abc.abstractmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        """The K terms, each of the shape of the pair, 1/sr; 0 below the horizon."""

    @classmethod
    def coefficients(
        cls, spec: ModelSpec, linear: Mapping[str, Array], nonlinear: Mapping[str, Array]
    ) -> tuple[Array, ...]:
        """The K coefficients, each (C,), all >= 0 for parameters within bounds.

        The linear parameters themselves, in the table's order, unless a family says otherwise.
        """
        del nonlinear
        return tuple(linear[p.name] for p in cls.parameter_table(spec) if p.linear)

    @classmethod
    def linear_from(
        cls, spec: ModelSpec, coefficients: Sequence[Array], nonlinear: Mapping[str, Array]
    ) -> dict[str, Array]:
        """The linear parameters that give these coefficients: the inverse of :meth:`coefficients`."""
        del nonlinear
        names = [p.name for p in cls.parameter_table(spec) if p.linear]
        return dict(zip(names, coefficients, strict=True))

    @staticmethod
    def span(spec: ModelSpec) -> Span | None:
        """Of how few functions of the directions the terms are made, or None where they are not."""
        del spec
        return None

    @staticmethod
    def coefficients_are_free(spec: ModelSpec) -> bool:
        """Whether all non-negative coefficients are possible: as many linear parameters as terms."""
        del spec
        return True

    def parts(self, p: Pair) -> list[Array]:
        """The terms times their coefficients, (..., C) each: their sum is the value."""
        nonlinear = self.nonlinear
        if any(jnp.ndim(v) for v in nonlinear.values()):
            wide = Pair(*(component[..., None] for component in p))
            terms = type(self).terms(self.spec, nonlinear, wide)
        else:
            terms = tuple(t[..., None] for t in type(self).terms(self.spec, nonlinear, p))
        coefficients = type(self).coefficients(self.spec, self.linear, nonlinear)
        return [term * coefficient for term, coefficient in zip(terms, coefficients, strict=True)]

    def value(self, p: Pair) -> Array:
        return functools.reduce(operator.add, self.parts(p))


def quotient(part: Array, whole: Array) -> Array:
    """part/whole, and 0 where there is no whole: what a parameter without effect is set to."""
    some = whole > 0
    return jnp.where(some, part / jnp.where(some, whole, 1.0), 0.0)


@eqx.filter_jit
def _evaluate(model: ReflectanceModel, wi: Array, wo: Array) -> Array:
    return model.value(Pair.split(wi, wo))


@eqx.filter_jit
def mixture_density(model: ReflectanceModel, wi: Array, wo: Array) -> Array:
    """The compiled part of :meth:`ReflectanceModel.pdf`: of directions (..., 3) of the model's dtype."""
    p = Pair.split(wi, wo)
    lobes, shares, _ = model.mixture(p.ix, p.iy, p.iz)
    return mixture_pdf(lobes, shares, p, model.transmits(model.spec))


@eqx.filter_jit
def _sample(model: ReflectanceModel, wi: Array, n: int, key: Array) -> tuple[Array, ...]:
    lobes, shares, deltas = model.mixture(wi[0], wi[1], wi[2])
    transmits = model.transmits(model.spec)
    wo, pick = sample_mixture(lobes, shares, deltas, wi, n, key)
    pair = Pair.split(wi, wo)
    pdf = mixture_pdf(lobes, shares, pair, transmits)
    valid = (wo[:, 2] != 0) if transmits else (wo[:, 2] > 0)
    ok = valid & (pdf > 0)
    weight = jnp.zeros((n, len(model.channels)), wi.dtype)
    is_delta = pick >= len(lobes)
    if lobes:
        found = model.value(pair) * (jnp.abs(wo[:, 2]) / jnp.where(ok, pdf, 1.0))[:, None]
        weight = jnp.where((ok & ~is_delta)[:, None], found, weight)
    for k, delta in enumerate(deltas):
        share = shares[len(lobes) + k]
        chosen = pick == len(lobes) + k
        weight = jnp.where(chosen[:, None], delta.weight / jnp.where(share > 0, share, 1.0), weight)
        # An ideal direction has no density: its weight is all there is to it.
        pdf = jnp.where(chosen, 0.0, pdf)
    return wo, pdf, weight, valid, is_delta


@eqx.filter_jit
def _albedo_one(model: ReflectanceModel, wi: Array, reflected: bool) -> Array:
    # Light from below is reflected to below.
    side = jnp.where(wi[2] < 0, -1.0, 1.0)
    up, whole = wi.at[2].multiply(side), not model.isotropic(model.spec)

    def over(index: Array | None) -> Array:
        wo, weight = _albedo.quadrature(up, whole, index)
        pair = Pair.split(wi, wo.at[:, 2].multiply(side if reflected else -side))
        return jnp.sum(model.value(pair) * weight[:, None], axis=0)

    if reflected:
        total = over(None)
    else:
        eta = jnp.atleast_1d(model.refractive_index(model.spec, model.values))
        # With dispersion each channel has a quadrature of its own.
        found = [over(index) for index in jnp.where(side > 0, eta, 1.0 / eta)]
        total = found[0] if len(found) == 1 else jnp.stack([one[k] for k, one in enumerate(found)])
    for delta in model.deltas(model.spec, model.values, wi[0], wi[1], wi[2]):
        total = total + jnp.where((delta.z * side > 0) == reflected, delta.weight, 0.0)
    return total


def cast(model: ReflectanceModel, dtype: Any) -> ReflectanceModel:
    """The model with its values in the dtype of the directions: float32 in, float32 throughout."""
    return eqx.tree_at(lambda m: m.values, model, {k: jnp.asarray(v, dtype) for k, v in model.values.items()})


def _directions(wi: ArrayLike, wo: ArrayLike) -> tuple[Array, Array]:
    i, o = jnp.asarray(wi), jnp.asarray(wo)
    for name, w in (("wi", i), ("wo", o)):
        if w.shape[-1:] != (3,):
            raise _shape_error(name, w.shape)
    if not jnp.issubdtype(jnp.result_type(i, o), jnp.floating):
        i, o = i.astype(float), o.astype(float)
    return i, o


def _shape_error(name: str, shape: tuple[int, ...], expected: str = "(..., 3)") -> SpecError:
    return SpecError(
        f"{name} has shape {shape}, expected {expected}", code="bad-directions", parameter=name,
        remedy="give unit vectors that point away from the surface",
    )  # fmt: skip
