"""predictive: where a new measurement would fall, the model's misfit included.

Residuals over a scale that grows with the value, sqrt((r f)^2 + e^2), are a Gaussian process over directions
(C. Rasmussen, C. Williams, "Gaussian Processes for Machine Learning", 2006, ch. 2): Matern 3/2 and
independent noise, its numbers by maximum likelihood. What the parameters' uncertainty (the robust one) does
to the values is a part of the same process, linear in them: where there are measurements they know better.
Near measured directions the misfit is known, and the band follows it, away from the model's own curve; far
from them it is as wide as misfits are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, optimize, special

from fitter import models
from fitter.compression import CompressedTable
from fitter.directions import half_difference_from_vectors, spherical_from_vector
from fitter.fitting.result import FitResult
from fitter.fitting.samples import padded
from fitter.models.padded import evaluated
from fitter.posterior.correlated import distances, matern
from fitter.posterior.jackknife import Robust, used_by
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Samples that the process's numbers are estimated from, and that it is conditioned on, at most.
ESTIMATED_FROM, CONDITIONED_ON = 350, 1_000
#: Samples that the scale is estimated from, at most.
SCALED_FROM = 20_000
#: What ranges are shortened by: between scans the misfit changes faster than along them. Chosen on measured
#: tables by a prototype; leaving any one of them out chose it as well.
SHORTENED = 0.6
RANGES = np.geomspace(0.05, 3.0, 18)
SHARES = (0.0, 0.3, 0.6, 0.8, 0.9, 0.97, 0.99, 0.997, 0.999)
#: Added to a unit diagonal before it is factorised.
JITTER = 1e-8
#: Residuals below this share of a typical value are rounding.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Process:
    """The residuals of one channel.

    relative, floor : of the scale. reach, share : of the correlation, the rest being independent noise.
    size : standard deviation of the scaled residuals. at : (n, 4) features that it is conditioned on, and
    slopes : (n, Q) what the parameters' principal directions do to the scaled values there.
    factor, weights : Cholesky factor of the covariances there and its solution for the scaled residuals.
    """

    relative: float
    floor: float
    reach: float
    share: float
    size: float
    at: FloatArray
    slopes: FloatArray
    factor: FloatArray
    weights: FloatArray

    def scale(self, f: FloatArray) -> FloatArray:
        return np.hypot(self.relative * f, self.floor)

    def at_new(self, at: FloatArray, slopes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (m,) of scaled residuals of new measurements at features (m, 4)."""
        field = self.size**2 * self.share * matern(distances(at, self.at) / self.reach)
        cross = field + slopes @ self.slopes.T
        half = linalg.solve_triangular(self.factor, cross.T, lower=True)
        whole = self.size**2 + np.square(slopes).sum(axis=1)
        left = np.maximum(whole - np.square(half).sum(axis=0), self.size**2 * (1.0 - self.share + JITTER))
        return cross @ self.weights, np.sqrt(left)


@dataclass(frozen=True)
class Predictive:
    """Bands of new measurements. template : the fitted model. covariance : (Q, Q) robust, of the free
    parameters ``labels``; what has no stated uncertainty has none here. processes : by channel."""

    template: models.ReflectanceModel
    labels: tuple[str, ...]
    covariance: FloatArray
    processes: Sequence[Process]
    seed: int

    def predict(self, wi: ArrayLike, wo: ArrayLike, level: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """(lower, upper), each (M, C): where a new measurement falls with probability ``level``.

        It promises nothing outside the measured domain: a misfit that was never seen is not in it.
        """
        wi, wo = (np.atleast_2d(np.asarray(w, np.float64)) for w in (wi, wo))
        f, at = evaluated(self.template, wi, wo), features(wi, wo)
        moved = slopes(self.template, self.labels, self.covariance, wi, wo)
        tail = float(special.ndtri(0.5 + 0.5 * level))
        lower, upper = np.empty_like(f), np.empty_like(f)
        for c, process in enumerate(self.processes):
            scale = process.scale(f[:, c])
            mean, deviation = process.at_new(at, moved[:, :, c] / scale[:, None])
            centre, half = f[:, c] + scale * mean, tail * scale * deviation
            lower[:, c], upper[:, c] = centre - half, centre + half
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
            name, _, channel = labels[position].partition("[")
            tangent[name][model.channels.index(channel[:-1]) if channel else ()] = amount
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
    table: Table | CompressedTable, fit: FitResult, robust: Robust | None = None, seed: int = 0
) -> Predictive:
    """The bands of a fit from the table that was fitted.

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
    residual = whole.value[data.index[order]][:, list(data.channels)] - f
    covariance = fit.covariance if robust is None else robust.covariance
    few = slice(CONDITIONED_ON)
    moved = slopes(fit.model, fit.labels, covariance, wi[few], wo[few])
    return Predictive(
        template=fit.model,
        labels=fit.labels,
        covariance=covariance,
        processes=_processes(residual, f, at, moved),
        seed=seed,
    )


def features(wi: FloatArray, wo: FloatArray) -> FloatArray:
    """(n, 4) of pairs: 2 sqrt(theta_h), theta_d, theta_i, theta_o in radians; the root stretches the peak."""
    theta_h, _, theta_d, _ = half_difference_from_vectors(wi, wo)
    theta_i, theta_o = (spherical_from_vector(w)[0] for w in (wi, wo))
    return np.stack([2.0 * np.sqrt(theta_h), theta_d, theta_i, theta_o], axis=1)


def _processes(residual: FloatArray, f: FloatArray, at: FloatArray, moved: FloatArray) -> list[Process]:
    """Scale, correlation and conditioning of each channel of residuals (n, C), in random order, the first of
    them with what the parameters do (m, Q, C)."""
    scales = [_scale(r, value) for r, value in zip(residual.T, f.T, strict=True)]
    z = residual / np.stack([np.hypot(r * f[:, c], e) for c, (r, e) in enumerate(scales)], axis=1)
    few, used = min(ESTIMATED_FROM, len(z)), min(CONDITIONED_ON, len(z))
    correlations = _likeliest(z[:few], distances(at[:few], at[:few]))
    at, z = at[:used], z[:used]
    distance = distances(at, at)
    found: list[Process] = []
    for c, ((relative, floor), (reach, share)) in enumerate(zip(scales, correlations, strict=True)):
        short = reach * SHORTENED
        matrix = share * matern(distance / short) + (1.0 - share + JITTER) * np.eye(used)
        half = linalg.solve_triangular(np.linalg.cholesky(matrix), z[:, c], lower=True)
        size = float(np.sqrt(max(float(half @ half), 1e-300) / used))
        own = moved[:, :, c] / np.hypot(relative * f[:used, c], floor)[:, None]
        factor = np.asarray(np.linalg.cholesky(size**2 * matrix + own @ own.T), np.float64)
        weights = linalg.cho_solve((factor, True), z[:, c])
        found.append(Process(relative, floor, short, share, size, at, own, factor, weights))
    return found


def _scale(residual: FloatArray, f: FloatArray) -> tuple[float, float]:
    """r and e of the scale sqrt((r f)^2 + e^2), by maximum likelihood of independent normal residuals."""
    typical = max(float(np.median(np.abs(f))), 1e-300)
    unit = np.square(residual / typical)
    level = np.square(f / typical)

    def loss(logs: FloatArray) -> float:
        variance = np.exp(2.0 * logs[0]) * level + np.exp(2.0 * logs[1]) + ROUNDING**2
        return float(np.mean(unit / variance + np.log(variance)))

    begin = np.log(max(float(np.sqrt(np.mean(unit))), ROUNDING)) + np.array([-0.5, -1.0])
    found = optimize.minimize(loss, begin, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-6})
    relative, floor = np.exp(found.x)
    return float(relative), float(np.hypot(floor, ROUNDING) * typical)


def _likeliest(z: FloatArray, distance: FloatArray) -> list[tuple[float, float]]:
    """Range and share of the correlation under which scaled residuals (n, C) are likeliest, their size taken
    out, by channel. One decomposition of a field serves all shares and channels."""
    n, channels = z.shape
    best, chosen = np.full(channels, -np.inf), [(float(RANGES[0]), 0.0)] * channels
    for reach in RANGES:
        values, vectors = np.linalg.eigh(matern(distance / reach))
        squared = np.square(vectors.T @ z)
        for share in SHARES:
            spectrum = share * np.maximum(values, 0.0) + 1.0 - share + JITTER
            sums = np.maximum((squared / spectrum[:, None]).sum(axis=0), 1e-300)
            likelihood = -0.5 * (n * np.log(sums) + np.log(spectrum).sum())
            for c in np.flatnonzero(likelihood > best):
                best[c], chosen[c] = likelihood[c], (float(reach), share)
    return chosen
