"""Integrals over the scattered directions estimated from draws, with their standard errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter.errors import SpecError
from fitter.sampling.samples import Samples

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Moment:
    """An estimated integral: value and its standard error, each (C,) or (C, K); draws : how many it rests on.

    The standard error is that of the mean of independent draws; with one draw it is infinite.
    """

    value: FloatArray
    standard_error: FloatArray
    draws: int


def moment(
    samples: Samples | Iterable[Samples], function: Callable[[FloatArray], ArrayLike] | None = None
) -> Moment:
    """The integral of g(wo) f_r(wi, wo) cos(theta_o) over wo, per channel.

    Parameters
    ----------
    samples : draws for one incidence, or parts of them (:meth:`TableSampler.stream`), which are used one by
        one and let go. Of pairs (:meth:`TableSampler.sample_pairs`) the integral is over both hemispheres
        and has the factor cos(theta_i).
    function : (n, 3) directions wo -> (n,) or (n, K) values of g; default 1, which gives the
        directional-hemispherical reflectance.

    The estimate is unbiased. Mean and spread are accumulated part by part in the form that does not cancel
    (T. Chan, G. Golub, R. LeVeque 1983). Raises SpecError where g has another shape, or without draws.
    """
    count, mean, spread = 0, np.zeros(0), np.zeros(0)
    for part in (samples,) if isinstance(samples, Samples) else samples:
        n = len(part)
        if n == 0:
            continue
        value = part.weight
        if function is not None:
            g = np.asarray(function(part.wo), np.float64)
            if g.ndim not in (1, 2) or len(g) != n:
                raise SpecError(
                    f"the function gave an array {g.shape} for {n} directions", code="bad-function",
                    parameter="function", remedy="give one value, or one row of values, per direction",
                )  # fmt: skip
            value = value * g[:, None] if g.ndim == 1 else value[:, :, None] * g[:, None, :]
        own = value.mean(axis=0)
        squares = ((value - own) ** 2).sum(axis=0)
        if count == 0:
            count, mean, spread = n, own, squares
            continue
        total = count + n
        mean = mean + (own - mean) * (n / total)
        spread = spread + squares + (own - mean) ** 2 * (n * total / count)
        count = total
    if count == 0:
        raise SpecError("there are no draws to estimate from", code="no-draws", parameter="samples")
    error = np.sqrt(spread / (count - 1) / count) if count > 1 else np.full(mean.shape, np.inf)
    return Moment(mean, error, count)
