"""The numerical self-test of a model: is it, on this machine, what it claims to be?

Each figure is a number beside the bound it has to keep, or beside none where it only informs. Parameters have
their defaults, or the nonlinear ones are all at one end of their range.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike, NDArray

from fitter.models.base import ReflectanceModel
from fitter.models.check_albedo import largest_albedo, made
from fitter.models.check_distributions import distributions
from fitter.models.check_sampling import sampling
from fitter.models.registry import family_of
from fitter.spec import ModelSpec

Floats = NDArray[Any]

#: Cosines and differences of azimuth at which a naive implementation breaks.
COSINES = (1e-6, 1e-3, 0.3, 0.8, 1.0 - 1e-9, 1.0)
AZIMUTHS = (0.0, 1e-8, 0.7, np.pi / 2, np.pi - 1e-8, np.pi)
RANDOM_PAIRS = 100
#: Pairs a timing takes, and the fewer of models that integrate at every pair: whose values and slopes take
#: more than DEAR seconds each.
TIMED_PAIRS, TIMED_DEAR, DEAR = 2**16, 2**10, 2e-4
#: Smaller values, 1/sr, are not normal numbers in float32.
SMALLEST = 1e-37


@dataclass(frozen=True)
class Figure:
    """One number of the self-test; ``where`` says what it was worst at."""

    name: str
    value: float
    bound: float | None = None
    where: str = ""
    at_least: bool = False

    @property
    def ok(self) -> bool:
        if not np.isfinite(self.value):
            return False
        if self.bound is None:
            return True
        return bool(self.value >= self.bound if self.at_least else self.value <= self.bound)

    def to_dict(self) -> dict[str, Any]:
        value = self.value if np.isfinite(self.value) else None
        bound = {"at_least" if self.at_least else "at_most": self.bound}
        return {"name": self.name, "value": value, **bound, "where": self.where, "ok": self.ok}


def check(spec: ModelSpec) -> dict[str, Any]:
    """JSON-ready: every figure of one model, and whether all keep their bounds."""
    return _report(spec.name, _figures(spec))


def check_distributions() -> dict[str, Any]:
    """The same for the distributions of microfacets and the masking forms (:mod:`.check_distributions`)."""
    return _report("distributions", (Figure(*figure) for figure in distributions()))


def _report(name: str, figures: Iterator[Figure]) -> dict[str, Any]:
    start = time.perf_counter()
    found: list[Figure] = []
    error = None
    try:
        found.extend(figures)
    except Exception as problem:  # a self-test reports what breaks and goes on with the next model
        error = f"{type(problem).__name__}: {problem}"
    return {
        "name": name, "ok": error is None and all(figure.ok for figure in found), "error": error,
        "figures": [figure.to_dict() for figure in found], "seconds": time.perf_counter() - start,
    }  # fmt: skip


def _figures(spec: ModelSpec) -> Iterator[Figure]:
    settings = parameter_settings(spec)
    yield from _finite(spec, settings)
    yield from _precision(spec, settings)
    dear = _dear(made(spec, settings["defaults"]))
    for dtype in (np.float64, np.float32):
        seconds = _cost(made(spec, settings["defaults"], ("R", "G", "B")), dtype, dear)
        yield Figure(f"cost {np.dtype(dtype).name}", seconds * 1e9, where="ns per RGB pair")
    yield from (Figure(*figure) for figure in sampling(made(spec, settings["defaults"]), dear))
    value, where = largest_albedo(spec, settings, dear)
    # Not a fault but a property of some models: it informs.
    yield Figure("largest albedo", value, where=where)


def parameter_settings(spec: ModelSpec) -> dict[str, dict[str, float]]:
    """Parameter values by a name for them: the defaults, and the nonlinear ones at either end."""
    table = family_of(spec).parameter_table(spec)
    defaults = {p.name: p.default for p in table}
    free = [p for p in table if not p.linear]
    if not free:
        return {"defaults": defaults}
    return {
        "defaults": defaults,
        "lower bounds": {**defaults, **{p.name: p.lower for p in free}},
        "upper bounds": {**defaults, **{p.name: min(p.upper, 1e6) for p in free}},
    }


def pairs(dtype: type) -> tuple[Floats, Floats]:
    """Unit vectors wi, wo (M, 3): every combination of the hard cosines and azimuths, then random ones."""
    mu_i, mu_o, phi = (a.reshape(-1) for a in np.meshgrid(COSINES, COSINES, AZIMUTHS, indexing="ij"))
    rng = np.random.default_rng(0)
    more_i, more_o = rng.uniform(0.02, 1.0, (2, RANDOM_PAIRS))
    phi_i = np.concatenate([np.full(len(phi), 0.4), rng.uniform(-np.pi, np.pi, RANDOM_PAIRS)])
    phi_o = np.concatenate([phi + 0.4, rng.uniform(-np.pi, np.pi, RANDOM_PAIRS)])
    wi = _direction(np.concatenate([mu_i, more_i]), phi_i)
    return wi.astype(dtype), _direction(np.concatenate([mu_o, more_o]), phi_o).astype(dtype)


def _direction(mu: Floats, phi: Floats) -> Floats:
    s = np.sqrt((1.0 - mu) * (1.0 + mu))
    return np.stack([s * np.cos(phi), s * np.sin(phi), mu], axis=-1)


@eqx.filter_jit
def _slopes(model: ReflectanceModel, wi: Array, wo: Array) -> tuple[Array, dict[str, Array], Array, Array]:
    """f of a one-channel model at each pair (M,), and its derivatives: (M,) by parameter, (M, 3) twice."""

    def value(values: Mapping[str, Array], i: Array, o: Array) -> Array:
        return eqx.tree_at(lambda m: m.values, model, values).evaluate(i, o)[:, 0]

    # Forward in the few parameters, backward in the many directions: what pairs share is worked out once.
    by_value = jax.jacfwd(value)(model.values, wi, wo)
    f, back = jax.vjp(lambda i, o: value(model.values, i, o), wi, wo)
    by_wi, by_wo = back(jnp.ones_like(f))
    return f, {name: slope.reshape(len(wi)) for name, slope in by_value.items()}, by_wi, by_wo


def _finite(spec: ModelSpec, settings: Mapping[str, Mapping[str, float]]) -> Iterator[Figure]:
    for dtype in (np.float64, np.float32):
        wi, wo = pairs(dtype)
        bad, where = 0, ""
        for name, values in settings.items():
            found = jax.tree.leaves(_slopes(made(spec, values), jnp.asarray(wi), jnp.asarray(wo)))
            broken = ~np.isfinite(np.column_stack([np.asarray(leaf) for leaf in found])).all(axis=1)
            if broken.any() and not bad:
                k = int(np.argmax(broken))
                where = f"{name}, {_place(wi[k], wo[k])}"
            bad += int(broken.sum())
        yield Figure(f"not finite {np.dtype(dtype).name}", float(bad), 0.0, where or "value and gradients")


def _precision(spec: ModelSpec, settings: Mapping[str, Mapping[str, float]]) -> Iterator[Figure]:
    """Differences over their allowances: of exchanged directions, and of float32 from float64."""
    wi, wo = pairs(np.float32)
    exchanged, single = (0.0, ""), (0.0, "")
    # A model that tabulates or integrates may state a bound of its own.
    own = family_of(spec).float32_error
    for name, values in settings.items():
        # The same stored numbers in both types.
        model = made(spec, _inside(spec, values))
        double_i, double_o = (jnp.asarray(w, np.float64) for w in (wi, wo))
        f, slope = _condition(model, double_i, double_o)
        back, narrow = _condition(model, double_o, double_i)[0], _condition(model, wi, wo)[0]
        allowed = [
            _allowed(model, double_i, double_o, f, slope, dtype, least)
            for dtype, least in ((np.float64, 1e-13), (np.float32, own))
        ]
        exchanged = max(exchanged, _worst(np.abs(back - f) / allowed[0], f, name, wi, wo))
        single = max(single, _worst(np.abs(narrow - f) / allowed[1], f, name, wi, wo))
    if family_of(spec).reciprocal(spec):
        yield Figure("reciprocity", exchanged[0], 1.0, f"{exchanged[1]}, over 1e-13 + 8 eps kappa")
    yield Figure("float32 from float64", single[0], 1.0, f"{single[1]}, over {own:g} + 8 eps kappa")


def _inside(spec: ModelSpec, values: Mapping[str, float]) -> dict[str, float]:
    """Values as float32 stores them, kept within their bounds."""
    found = {name: float(np.float32(value)) for name, value in values.items()}
    for p in family_of(spec).parameter_table(spec):
        if found[p.name] < p.lower:
            found[p.name] = float(np.nextafter(np.float32(found[p.name]), np.float32(np.inf)))
        elif found[p.name] > p.upper:
            found[p.name] = float(np.nextafter(np.float32(found[p.name]), np.float32(-np.inf)))
    return found


def _allowed(
    model: ReflectanceModel, wi: Array, wo: Array, f: Floats, slope: Floats, dtype: type, own: float
) -> Floats:
    """What rounding may do to f, 1/sr: f (own + 8 eps kappa), f kappa = slope = sum |x df/dx| over inputs.

    Beside a kink or a jump the other side counts too, as far as a few roundings of the directions reach.
    """
    eps = float(np.finfo(dtype).eps)
    nudge_i, nudge_o = eps * np.random.default_rng(2).uniform(-8.0, 8.0, (2, *wi.shape))
    jump = np.zeros_like(f)
    for sign in (1.0, -1.0):
        near, steep = _condition(model, wi * (1.0 + sign * nudge_i), wo * (1.0 + sign * nudge_o))
        slope, jump = np.maximum(slope, steep), np.maximum(jump, np.abs(near - f))
    return own * f + 8.0 * eps * slope + jump + SMALLEST


def _condition(model: ReflectanceModel, wi: ArrayLike, wo: ArrayLike) -> tuple[Floats, Floats]:
    """f, and sum |x df/dx| over all stored inputs."""
    wi, wo = jnp.asarray(wi), jnp.asarray(wo)
    f, by_value, by_wi, by_wo = _slopes(model, wi, wo)
    total = jnp.sum(jnp.abs(by_wi * wi), axis=1) + jnp.sum(jnp.abs(by_wo * wo), axis=1)
    for name, slope in by_value.items():
        total = total + jnp.abs(slope * model.values[name].reshape(()))
    return np.asarray(f, np.float64), np.asarray(total, np.float64)


def _worst(ratio: Floats, f: Floats, name: str, wi: Floats, wo: Floats) -> tuple[float, str]:
    """The largest ratio, and where."""
    k = int(np.argmax(np.where(np.isnan(ratio), np.inf, ratio)))
    found = float(ratio[k]) if np.isfinite(ratio[k]) else np.inf
    return found, f"{name}, {_place(wi[k], wo[k])}, f = {f[k]:.3g}"


def _place(wi: Floats, wo: Floats) -> str:
    azimuth = np.arctan2(wo[1], wo[0]) - np.arctan2(wi[1], wi[0])
    return f"cosines {wi[2]:.3g} and {wo[2]:.3g}, azimuth {azimuth:.3g}"


def _cost(model: ReflectanceModel, dtype: type, dear: bool) -> float:
    """Seconds to evaluate one pair, best of three runs after one that compiles."""
    count = TIMED_DEAR if dear else TIMED_PAIRS
    rng = np.random.default_rng(1)
    mu_i, mu_o = rng.uniform(0.02, 1.0, (2, count))
    phi_i, phi_o = rng.uniform(-np.pi, np.pi, (2, count))
    wi, wo = (jnp.asarray(_direction(mu, phi), dtype) for mu, phi in ((mu_i, phi_i), (mu_o, phi_o)))
    return min(_seconds(lambda: model.evaluate(wi, wo).block_until_ready()) for _ in range(4)) / count


def _dear(model: ReflectanceModel) -> bool:
    """Whether it integrates at every pair, so that fewer have to do."""
    wi, wo = pairs(np.float64)
    return min(_seconds(lambda: _condition(model, wi, wo)) for _ in range(3)) > DEAR * len(wi)


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
