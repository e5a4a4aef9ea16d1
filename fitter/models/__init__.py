"""Reflectance models: one file per family, and the parts they share."""

from __future__ import annotations

from fitter._jax import enable_x64

enable_x64()

from collections.abc import Mapping, Sequence  # noqa: E402
from typing import Any  # noqa: E402

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from numpy.typing import ArrayLike  # noqa: E402

from fitter.errors import SpecError  # noqa: E402
from fitter.models.base import ReflectanceModel  # noqa: E402
from fitter.models.parameters import Parameter  # noqa: E402
from fitter.models.registry import family_of  # noqa: E402
from fitter.spec import CANON, FAMILIES, ModelSpec, model_spec  # noqa: E402

__all__ = [
    "CANON", "FAMILIES", "Parameter", "ReflectanceModel", "create", "family_of", "from_dict",
    "parameter_table",
]  # fmt: skip


#: Scales beyond this make products of a model's terms overflow.
LARGEST = 1e150


def parameter_table(model: ModelSpec | str) -> tuple[Parameter, ...]:
    """The parameters of a model, linear ones first."""
    spec = model_spec(model)
    return family_of(spec).parameter_table(spec)


def create(
    model: ModelSpec | str, *, channels: Sequence[str] | None = None, **values: ArrayLike
) -> ReflectanceModel:
    """A model from parameter values, scalars or one per channel; those left out take their default.

    >>> create("ward", kd=[0.1, 0.2, 0.3], ks=0.05, alpha=0.1).channels
    ('R', 'G', 'B')

    Raises SpecError naming the parameter when it is unknown, not finite, outside its bounds, or of a
    length that does not fit the channels.
    """
    spec = model_spec(model)
    table = _known(spec, values)
    arrays = {p.name: np.asarray(values.get(p.name, p.default), np.float64) for p in table}
    lengths = {array.size for array in arrays.values() if array.ndim}
    if channels is not None:
        lengths.add(len(channels))
    if len(lengths) > 1 or any(array.ndim > 1 for array in arrays.values()):
        raise SpecError(
            f"parameters of different lengths ({sorted(lengths)})", code="bad-parameter-shape",
            remedy="give scalars, or one value per channel",
        )  # fmt: skip
    count = next(iter(lengths), 1)
    if channels is None:
        channels = {1: ("value",), 3: ("R", "G", "B")}.get(count, tuple(f"c{k}" for k in range(count)))
    filled: dict[str, Any] = {}
    for p in table:
        array = arrays[p.name]
        upper = min(p.upper, LARGEST)
        if not np.isfinite(array).all() or (array < p.lower).any() or (array > upper).any():
            raise SpecError(
                f"{p.name} = {array.tolist()} is outside [{p.lower:g}, {upper:g}]",
                code="parameter-out-of-bounds", parameter=p.name,
                remedy=f"{p.name} is {p.description}, unit {p.unit}" + _printed_too_high(p, array),
            )  # fmt: skip
        filled[p.name] = jnp.asarray(np.broadcast_to(array, (count,)) if p.linear else array)
    return family_of(spec)(spec=spec, channels=tuple(channels), values=filled)


def _printed_too_high(p: Parameter, array: np.ndarray) -> str:
    """A hint where a reflectance is a little above 1."""
    if not (p.linear and p.upper == 1.0 and (array > 1).any() and (array <= 1.5).all()):
        return ""
    return (
        "; printed reflectances of metals in linear RGB can exceed 1 (gold's red is 1.022): "
        "clamp them yourself, nothing is clamped silently"
    )


def _known(spec: ModelSpec, values: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """The model's parameter table, once every name in ``values`` is in it."""
    table = parameter_table(spec)
    known = [p.name for p in table]
    for name in values:
        if name not in known:
            raise SpecError(
                f"{spec.name} has no parameter {name!r}", code="unknown-parameter", parameter=name,
                remedy=f"its parameters are {', '.join(known)}",
            )  # fmt: skip
    return table


def from_dict(document: Mapping[str, Any]) -> ReflectanceModel:
    """The model that :meth:`ReflectanceModel.to_dict` wrote. Raises SpecError on anything else."""
    try:
        spec, channels, values = document["spec"], document["channels"], document["values"]
        given = {str(name): np.asarray(value, np.float64) for name, value in values.items()}
        names = [str(channel) for channel in channels]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SpecError(
            f"this is not a model document ({error!r})", code="bad-model-document",
            remedy="it needs spec, channels and values, as `fit --json` prints under model",
        ) from error  # fmt: skip
    chosen = model_spec(spec)
    # By name, not by keyword: a stranger's document may hold any key.
    _known(chosen, given)
    return create(chosen, channels=names, **given)
