"""The verbs every reflectance model has: evaluate, sample, pdf, albedo."""

from __future__ import annotations

import abc
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
from fitter.models.lobes import Lobe, mixture_pdf, sample_mixture
from fitter.models.pair import Pair
from fitter.models.parameters import Parameter
from fitter.sampling.samples import Samples
from fitter.spec import ModelSpec

#: The smallest share of draws any component of a model gets, so that no weight is without bound
#: where a component that looks weak on average is the strong one.
SMALLEST_SHARE = 0.1


class ReflectanceModel(eqx.Module):
    """A fitted or hand-made model: an immutable pytree of parameter values, (C,) per channel or () shared.

    A family is a subclass that says its parameter table, the *terms* its value is a sum of, the
    coefficients of these terms as functions of the linear parameters, and its lobes for sampling:

        f_r,c(wi, wo) = sum_k coefficient_k(linear_c) term_k(nonlinear_c; wi, wo)
    """

    spec: ModelSpec = eqx.field(static=True)
    channels: tuple[str, ...] = eqx.field(static=True)
    values: dict[str, Array]

    family: ClassVar[str]

    # What a family declares -------------------------------------------------------------------------

    @staticmethod
    @abc.abstractmethod
    def parameter_table(spec: ModelSpec) -> tuple[Parameter, ...]:
        """Its parameters, linear ones first."""

    @staticmethod
    @abc.abstractmethod
    def terms(spec: ModelSpec, nonlinear: Mapping[str, Array], p: Pair) -> tuple[Array, ...]:
        """The K terms, each of the shape of the pair, 1/sr; 0 below the horizon."""

    @classmethod
    def coefficients(cls, spec: ModelSpec, linear: Mapping[str, Array]) -> tuple[Array, ...]:
        """The K coefficients, each (C,), all >= 0 for parameters within bounds.

        The linear parameters themselves, in the table's order, unless a family says otherwise.
        """
        return tuple(linear[p.name] for p in cls.parameter_table(spec) if p.linear)

    @classmethod
    def linear_from(cls, spec: ModelSpec, coefficients: Sequence[Array]) -> dict[str, Array]:
        """The linear parameters that give these coefficients: the inverse of :meth:`coefficients`."""
        names = [p.name for p in cls.parameter_table(spec) if p.linear]
        return dict(zip(names, coefficients, strict=True))

    @staticmethod
    @abc.abstractmethod
    def lobes(spec: ModelSpec, values: Mapping[str, Array]) -> list[tuple[Lobe, Array]]:
        """The lobes to draw from, each with its unnormalised share ()."""

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

    def value(self, p: Pair) -> Array:
        """f_r of a pair of components: shape (..., C), 1/sr."""
        nonlinear = self.nonlinear
        if any(jnp.ndim(v) for v in nonlinear.values()):
            wide = Pair(*(component[..., None] for component in p))
            terms = type(self).terms(self.spec, nonlinear, wide)
        else:
            terms = tuple(t[..., None] for t in type(self).terms(self.spec, nonlinear, p))
        coefficients = type(self).coefficients(self.spec, self.linear)
        total = terms[0] * coefficients[0]
        for term, coefficient in zip(terms[1:], coefficients[1:], strict=True):
            total = total + term * coefficient
        return total

    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> Array:
        """f_r without the cosine, (..., C) in 1/sr, of unit vectors wi, wo (..., 3) that broadcast.

        0 where either direction is not above the horizon. The result has the dtype of the directions.
        """
        wi, wo = _directions(wi, wo)
        return _evaluate(_cast(self, jnp.result_type(wi, wo)), wi, wo)

    def pdf(self, wi: ArrayLike, wo: ArrayLike) -> Array:
        """Density (...,) of :meth:`sample` drawing wo given wi, per unit solid angle of the whole sphere.

        Its integral over the upper hemisphere is 1 less the share of draws lost below the horizon.
        """
        wi, wo = _directions(wi, wo)
        return _pdf(_cast(self, jnp.result_type(wi, wo)), wi, wo)

    def albedo(self, wi: ArrayLike) -> Array:
        """Directional-hemispherical reflectance (..., C) by quadrature (:mod:`fitter.models.albedo`)."""
        directions = jnp.asarray(wi, float)
        if directions.shape[-1:] != (3,):
            raise _shape_error("wi", directions.shape)
        flat = directions.reshape(-1, 3)
        found = [_albedo_one(self, one) for one in flat]
        return jnp.stack(found).reshape(*directions.shape[:-1], len(self.channels))

    def sample(self, wi: ArrayLike, n: int, *, seed: int | Array) -> Samples:
        """``n`` directions wo for one incidence wi (3,); the same seed gives the same draws."""
        direction = jnp.asarray(wi, float)
        if direction.shape != (3,):
            raise _shape_error("wi", direction.shape, "(3,)")
        if not 0 < n <= 100_000_000:
            raise SpecError(
                f"n is {n}", code="bad-sample-count", parameter="n", remedy="ask for 1 to 1e8 draws at a time"
            )
        if not bool(direction[2] > 0):
            raise SpecError(
                "wi is below the horizon", code="below-horizon", parameter="wi",
                remedy="directions point away from the surface: wi needs a positive z",
            )  # fmt: skip
        key = jax.random.key(seed) if isinstance(seed, int | np.integer) else seed
        # Sizes rounded up to a power of two: callers with any n share a few compiled programs.
        size = max(1024, 1 << (n - 1).bit_length())
        wo, pdf, weight, valid = (np.asarray(part)[:n] for part in _sample(self, direction, size, key))
        return Samples(
            wo=wo, pdf=pdf, weight=weight, valid=valid,
            is_delta=np.zeros(n, bool), acceptance=1.0,
            seed=int(seed) if isinstance(seed, int | np.integer) else None,
        )  # fmt: skip

    def mixture(self) -> tuple[list[Lobe], Array]:
        """The lobes and their shares, which sum to 1 and are at least SMALLEST_SHARE / count each."""
        found = type(self).lobes(self.spec, self.values)
        shares = jnp.stack([jnp.maximum(share, 0.0) for _, share in found])
        total = jnp.sum(shares)
        even = jnp.ones_like(shares) / len(found)
        shares = jnp.where(total > 0, shares / jnp.where(total > 0, total, 1.0), even)
        return [lobe for lobe, _ in found], (1 - SMALLEST_SHARE) * shares + SMALLEST_SHARE * even

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready: what :func:`fitter.models.from_dict` reads back."""
        return {
            "spec": self.spec.model_dump(mode="json"),
            "name": self.spec.name,
            "channels": list(self.channels),
            "values": {name: np.asarray(v).tolist() for name, v in self.values.items()},
        }


@eqx.filter_jit
def _evaluate(model: ReflectanceModel, wi: Array, wo: Array) -> Array:
    return model.value(Pair.split(wi, wo))


@eqx.filter_jit
def _pdf(model: ReflectanceModel, wi: Array, wo: Array) -> Array:
    lobes, shares = model.mixture()
    return mixture_pdf(lobes, shares, Pair.split(wi, wo))


@eqx.filter_jit
def _sample(model: ReflectanceModel, wi: Array, n: int, key: Array) -> tuple[Array, Array, Array, Array]:
    lobes, shares = model.mixture()
    wo, valid = sample_mixture(lobes, shares, wi, n, key)
    pair = Pair.split(wi, wo)
    pdf = mixture_pdf(lobes, shares, pair)
    ok = valid & (pdf > 0)
    weight = model.value(pair) * (wo[:, 2] / jnp.where(ok, pdf, 1.0))[:, None]
    return wo, pdf, jnp.where(ok[:, None], weight, 0.0), valid


@eqx.filter_jit
def _albedo_one(model: ReflectanceModel, wi: Array) -> Array:
    wo, weight = _albedo.quadrature(wi)
    pair = Pair.split(wi, wo)
    return jnp.sum(model.value(pair) * weight[:, None], axis=0)


def _cast(model: ReflectanceModel, dtype: Any) -> ReflectanceModel:
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
