"""predictive: where a new measurement would fall, the model's misfit included.

Near measured directions the misfit is known, and the band follows it, away from the model's own curve; far
from them it is as wide as misfits are (:mod:`fitter.posterior.bands`). A new direction beside measured ones
and a scan at an incidence that was never measured are two questions, and have two bands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter import models
from fitter.compression import CompressedTable
from fitter.directions import half_difference_from_vectors, spherical_from_vector
from fitter.errors import SpecError
from fitter.fitting.blocks import padded
from fitter.fitting.result import FitResult
from fitter.models.labelled import place
from fitter.models.padded import evaluated
from fitter.posterior.bands import CONDITIONED_ON, chosen
from fitter.posterior.jackknife import Robust, used_by
from fitter.posterior.process import Process
from fitter.selection.blocks import blocks
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Samples that the size of residuals is read off, at most.
SCALED_FROM = 4_000

#: Fewer incidences than this say nothing about new ones.
FEWEST_SCANS = 3

New = Literal["directions", "scans"]


@dataclass(frozen=True)
class Predictive:
    """Bands of new measurements. template : the fitted model. covariance : (Q, Q) robust, of the free
    parameters ``labels``; what has no stated uncertainty has none here. processes : by what is new, and
    channel, several that the band is the mean of; new scans only where the table has several."""

    template: models.ReflectanceModel
    labels: tuple[str, ...]
    covariance: FloatArray
    processes: Mapping[New, Sequence[Sequence[Process]]]
    seed: int

    def predict(
        self, wi: ArrayLike, wo: ArrayLike, level: float = 0.95, *, new: New = "directions"
    ) -> tuple[FloatArray, FloatArray]:
        """(lower, upper), each (M, C) in 1/sr: where a new measurement falls with probability ``level``.

        It promises nothing outside the measured domain: a misfit that was never seen is not in it.
        new : "directions" beside measured ones, or "scans", at incidences that were not measured.

        Raises
        ------
        SpecError : "scans" where the table has too few to leave one out.
        """
        if new not in self.processes:
            raise SpecError(
                "the table has too few scans to say where a new one would lie", code="too-few-scans",
                parameter="new", remedy="use new='directions', near measured ones",
            )  # fmt: skip
        wi, wo = (np.atleast_2d(np.asarray(w, np.float64)) for w in (wi, wo))
        f, at = evaluated(self.template, wi, wo), features(wi, wo)
        moved = slopes(self.template, self.labels, self.covariance, wi, wo)
        lower, upper = np.empty_like(f), np.empty_like(f)
        for c, several in enumerate(self.processes[new]):
            each = [one.band(f[:, c], at, moved[:, :, c], level) for one in several]
            lower[:, c], upper[:, c] = np.mean(each, axis=0)
        return lower, upper


def slopes(
    model: models.ReflectanceModel, labels: Sequence[str], covariance: FloatArray, wi: FloatArray,
    wo: FloatArray,
) -> FloatArray:  # fmt: skip
    """(M, Q, C) what one standard deviation of the parameters ``labels`` along each principal direction of
    their covariance does to the values of a model; Q = 0 where none has a stated uncertainty."""
    known = np.flatnonzero(np.isfinite(np.diagonal(covariance)))
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance[np.ix_(known, known)]))
    n = len(wi)
    padding = ((0, padded(n) - n), (0, 0))
    wide = [jnp.pad(jnp.asarray(w), padding, mode="edge") for w in (wi, wo)]
    found = np.zeros((n, len(known), len(model.channels)))
    for k, (value, along) in enumerate(zip(values, vectors.T, strict=True)):
        tangent = {name: np.zeros_like(np.asarray(v)) for name, v in model.values.items()}
        for position, amount in zip(known.tolist(), along * np.sqrt(max(float(value), 0.0)), strict=True):
            name, where = place(labels[position], model.channels)
            tangent[name][where] = amount
        found[:, k] = np.asarray(_along(model, {k: jnp.asarray(v) for k, v in tangent.items()}, *wide))[:n]
    return found


@eqx.filter_jit
def _along(
    model: models.ReflectanceModel, tangent: dict[str, jax.Array], wi: jax.Array, wo: jax.Array
) -> jax.Array:
    def value(values: dict[str, jax.Array]) -> jax.Array:
        return eqx.tree_at(lambda m: m.values, model, values).evaluate(wi, wo)

    return jax.jvp(value, (dict(model.values),), (tangent,))[1]


def predictive(
    table: Table | CompressedTable, fit: FitResult, robust: Robust | None = None, seed: int = 0,
    new: Sequence[New] = ("directions", "scans"),
) -> Predictive:  # fmt: skip
    """The bands of a fit from the table that was fitted.

    new : the kinds that will be asked for; "scans" only where the table has enough of them.
    robust : of the same fit, for the parameters' part; None takes the fit's own covariance.
    seed : of the choice of samples where the table has many.

    Raises
    ------
    SpecError : the table lacks a channel of the fit.
    """
    whole = table.decompress() if isinstance(table, CompressedTable) else table
    data = used_by(whole, fit)
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(data))[:SCALED_FROM]
    pair = data.part([0], order, len(order)).pair
    wi, wo = pair[:3].T, pair[3:].T
    f, at = evaluated(fit.model, wi, wo), features(wi, wo)
    every = whole.value[data.index][:, list(data.channels)]
    y, ends = every[order], (np.minimum(every.min(axis=0), 0.0), every.max(axis=0))
    covariance = fit.covariance if robust is None else robust.covariance
    few = slice(CONDITIONED_ON)
    moved = slopes(fit.model, fit.labels, covariance, wi[few], wo[few])
    scan = blocks(wi, wo, 1, isotropic=fit.model.isotropic(fit.spec.model), fewest=FEWEST_SCANS)
    kinds: list[New] = [kind for kind in new if kind == "directions" or scan.kind is not None]
    found = chosen(y, f, at, moved, ends, [scan.block if kind == "scans" else None for kind in kinds])
    return Predictive(
        template=fit.model,
        labels=fit.labels,
        covariance=covariance,
        processes={kind: [channel[k] for channel in found] for k, kind in enumerate(kinds)},
        seed=seed,
    )


def features(wi: FloatArray, wo: FloatArray) -> FloatArray:
    """(n, 4) of pairs: 2 sqrt(theta_h), theta_d, theta_i, theta_o in radians; the root stretches the peak."""
    theta_h, _, theta_d, _ = half_difference_from_vectors(wi, wo)
    theta_i, theta_o = (spherical_from_vector(w)[0] for w in (wi, wo))
    return np.stack([2.0 * np.sqrt(theta_h), theta_d, theta_i, theta_o], axis=1)
