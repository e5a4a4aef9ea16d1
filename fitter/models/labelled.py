"""Values of a model by flat labels: "alpha" where the channels share one, "ks[G]" where each has its own."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter.models.base import ReflectanceModel


def place(label: str, channels: Sequence[str]) -> tuple[str, tuple[int, ...]]:
    """The parameter that a label stands for, and where in its values: (c,) of a channel, () of all."""
    name, bracket, rest = label.partition("[")
    return name, (channels.index(rest.removesuffix("]")),) if bracket else ()


def with_values(
    model: ReflectanceModel, labels: Sequence[str], numbers: NDArray[np.float64]
) -> ReflectanceModel:
    """The model with the numbers (..., Q) at these labels; all its values get the leading axes. Labels that
    are none of its parameters (a noise, say) are passed over."""
    leading = numbers.shape[:-1]
    values = {
        name: np.broadcast_to(v, leading + np.shape(v)).copy() for name, v in model.values.items()
    }  # fmt: skip
    for k, label in enumerate(labels):
        name, where = place(label, model.channels)
        if name in values:
            values[name][(..., *where)] = numbers[..., k]
    kept = {name: jnp.asarray(v) for name, v in values.items()}
    return type(model)(spec=model.spec, channels=model.channels, values=kept)
