"""Values and gradients of every closed-form model against 70 digits, on random hard cases.

err(f) <= |f| 1e-12 + 8 eps sum_k |x_k df/dx_k| in float64, 1e-5 for 1e-12 in float32, x being the stored
inputs: six components and the parameters. Gradients, by each parameter and the tangential part by each
direction: err(df/dx_j) <= 1e-12 |df/dx_j| + 8 eps (sum_k |x_k d2f/dx_j dx_k| + |f|/s_j), s_j being the scale
of x_j: itself for a width, else max(1, |x_j|). The last term is for factors, each exact, whose derivatives
cancel (D ~ alpha^2 and G/cos cos ~ 1/alpha^2 at grazing). Models with a series (a Smith term by Chebyshev's,
He and Torrance's own) state SERIES_GRADIENT for 1e-12, and as much of |f|/s_j: the derivative of a series has
fewer digits than its value. VALUE_FLOOR and GRADIENT_FLOOR are allowed in any case: XLA flushes factors
below the smallest normal number to 0. Beside a kink or a jump within 8 eps of the inputs either side is
right.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from mpmath import mp, mpf
from numpy.typing import NDArray

from fitter import models
from fitter.spec import ModelSpec, model_spec
from tests.evidence import domain
from tests.evidence.differences import Gradient, conditioning, gradient, sides
from tests.evidence.reference import DIGITS, has_reference, reference
from tests.evidence.study import Outcome, Study
from tests.models import MODELS

#: Points of a full run.
VALUES, GRADIENTS = 1500, 200

RELATIVE: Mapping[str, float] = {"float64": 1e-12, "float32": 1e-5}

#: The smallest normal number times the steepest factor of a lobe within the domain: where a term of f is
#: flushed to zero, so is its derivative.
GRADIENT_FLOOR = 1e-280

#: A hundred times the smallest normal number.
VALUE_FLOOR: Mapping[str, float] = {"float64": 3e-306, "float32": 1e-36}

#: Gradients of models with a series: Smith's term of Blinn's and the Gaussian distribution, He-Torrance.
SERIES_GRADIENT = 1e-10

#: Parameters that set a scale of their own, however small.
WIDTHS = ("alpha", "alpha_x", "alpha_y", "s", "roughness")

#: What 70 digits leave of a difference with a step of 1e-25, relative to f/x: a lobe that is 1e-40 of the
#: diffuse term has no derivative that could be judged.
UNRESOLVED = mpf("1e-40")

#: Models with an integral or a long series in the reference: fewer points.
SLOW_SHARE = 0.1

#: What holds no closed form, or no number at all.
SKIPPED: Mapping[str, str] = {
    "smooth_dielectric": "deltas only: evaluates to 0",
    "specular": "a delta only: evaluates to 0",
    "kulla_conty": "tabulated albedo with a bound of its own",
    "rough_facets": "quadrature with a bound of its own",
}

Floats = NDArray[np.float64]
COMPONENTS = ("ix", "iy", "iz", "ox", "oy", "oz")


class Points:
    """Inputs of one dtype: ``values`` by name and directions, and each as exact numbers."""

    def __init__(self, spec: ModelSpec, count: int, seed: int, dtype: str) -> None:
        rng = np.random.default_rng([seed, *spec.name.encode(), 32 if dtype == "float32" else 64])
        sided = spec.family == "rough_dielectric"
        drawn = domain.values(rng, models.parameter_table(spec), count, inside_too=sided)
        wi, wo, self.strata = domain.directions(rng, domain.lobe_width(drawn, count), below=sided)
        self.spec, self.names = spec, tuple(drawn)
        self.values = {name: v.astype(dtype) for name, v in drawn.items()}
        self.wi, self.wo = wi.astype(dtype), wo.astype(dtype)
        self.gradient_bound = SERIES_GRADIENT if _has_series(spec) else RELATIVE["float64"]

    def __len__(self) -> int:
        return len(self.wi)

    def exact(self, k: int) -> list[mpf]:
        """Six components, then the parameters."""
        numbers = [*self.wi[k], *self.wo[k], *(self.values[name][k] for name in self.names)]
        return [mpf(float(v)) for v in numbers]

    def function(self, x: Sequence[mpf]) -> mpf:
        """The reference at inputs in the order of :meth:`exact`."""
        return reference(self.spec, dict(zip(self.names, x[6:], strict=True)), x[:6])

    def told(self, k: int, **more: Any) -> dict[str, Any]:
        """One point for the record: floats as their shortest text that reads back."""
        return {
            **more, "stratum": str(self.strata[k]), "wi": [str(v) for v in self.wi[k]],
            "wo": [str(v) for v in self.wo[k]],
            "values": {name: str(self.values[name][k]) for name in self.names},
        }  # fmt: skip


def judge(name: str, share: float, seed: int) -> Outcome:
    """Worst err/bound of values in both precisions and of gradients, and what exceeds 1."""
    spec = model_spec(name)
    if not has_reference(spec):
        return Outcome({}, [{"what": f"{name} has no reference in tests/evidence/reference"}])
    share *= SLOW_SHARE if _slow(spec) else 1.0
    violations = [{"what": told} for told in domain.narrower(models.parameter_table(spec))]
    figures: dict[str, Any] = {}
    with mp.workdps(DIGITS):
        for dtype in ("float64", "float32"):
            points = Points(spec, max(8, round(VALUES * share)), seed, dtype)
            ratio, found = _values(points, dtype)
            figures |= {
                f"{dtype} points": len(points),
                f"{dtype} worst": ratio,
                f"{dtype} broken": len(found),
            }
            violations += _worst(found)
        points = Points(spec, max(4, round(GRADIENTS * share)), seed + 1, "float64")
        ratio, found = _gradients(points)
        figures |= {"gradient points": len(points), "gradient worst": ratio, "gradient broken": len(found)}
        violations += _worst(found)
    return Outcome(figures, violations)


def _has_series(spec: ModelSpec) -> bool:
    smith = spec.masking in ("smith", "smith_separable") and spec.ndf in ("blinn", "gaussian")
    return smith or spec.family == "he_torrance" or any(_has_series(part) for part in spec.components)


def _slow(spec: ModelSpec) -> bool:
    gaussian = spec.ndf == "gaussian" and _has_series(spec)
    return gaussian or spec.family == "he_torrance" or any(_slow(part) for part in spec.components)


def _worst(found: list[dict[str, Any]], kept: int = 5) -> list[dict[str, Any]]:
    return sorted(found, key=lambda one: -one["ratio"])[:kept]


# Values ---------------------------------------------------------------------------------------------


def _values(points: Points, dtype: str) -> tuple[float, list[dict[str, Any]]]:
    got = np.asarray(_program(points.spec.name)(points.values, points.wi, points.wo))
    if got.dtype != dtype:
        raise TypeError(f"{points.spec.name} returns {got.dtype} for {dtype}")
    limits = np.finfo(dtype)
    worst, broken = 0.0, list[dict[str, Any]]()
    for k in range(len(points)):
        expected, condition = conditioning(points.function, points.exact(k))
        if abs(expected) > float(limits.max):
            continue
        bound = RELATIVE[dtype] * abs(expected) + 8 * float(limits.eps) * condition + VALUE_FLOOR[dtype]
        ratio = _ratio(float(got[k]), expected, expected, bound)
        if not ratio <= 1:
            ratio = _ratio(float(got[k]), *_beside(points, k, expected, float(limits.eps)), bound)
        worst = max(worst, ratio)
        if not ratio <= 1:
            broken.append(points.told(
                k, what=f"{dtype} value", ratio=ratio, got=float(got[k]), expected=mp.nstr(expected, 20),
                relative_error=_relative(float(got[k]), expected), bound=mp.nstr(bound, 5),
            ))  # fmt: skip
    return worst, broken


def _beside(points: Points, k: int, expected: mpf, eps: float) -> tuple[mpf, mpf]:
    """The least and the largest value at inputs within 8 eps: more than a smooth change only at a jump."""
    found = [expected, *(points.function(x) for x in _nearby(points.exact(k), eps, 24))]
    return min(found), max(found)


def _nearby(x: Sequence[mpf], eps: float, count: int) -> Iterator[list[mpf]]:
    """Inputs within 8 eps of x, the same ones each time."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        shifts = rng.uniform(-8, 8, len(x)) * eps
        yield [v * (1 + float(s)) for v, s in zip(x, shifts, strict=True)]


def _ratio(got: float, low: mpf, high: mpf, bound: mpf) -> float:
    """How far outside [low, high] a number is, in bounds; infinite for what is not a number."""
    if not np.isfinite(got):
        return float("inf")
    return float(max(low - got, got - high, mpf(0)) / bound)


def _relative(got: float, expected: mpf) -> float:
    return float(abs(got - expected) / abs(expected)) if expected and np.isfinite(got) else float("inf")


@cache
def _value_of(name: str) -> Any:
    """(values by name, wi (3,), wo (3,)) -> f of one channel."""
    defaults = {p.name: p.default for p in models.parameter_table(name)}
    template = models.create(name, channels=("value",), **defaults)

    def value(given: Mapping[str, jax.Array], wi: jax.Array, wo: jax.Array) -> jax.Array:
        filled = {key: jnp.broadcast_to(given[key], template.values[key].shape) for key in given}
        return eqx.tree_at(lambda m: m.values, template, filled).evaluate(wi, wo)[0]

    return value


@cache
def _program(name: str) -> Any:
    return jax.jit(jax.vmap(_value_of(name)))


@cache
def _gradient_program(name: str) -> Any:
    return jax.jit(jax.vmap(jax.grad(_value_of(name), argnums=(0, 1, 2))))


# Gradients ------------------------------------------------------------------------------------------


def _gradients(points: Points) -> tuple[float, list[dict[str, Any]]]:
    by_value, by_wi, by_wo = _gradient_program(points.spec.name)(points.values, points.wi, points.wo)
    got = np.column_stack([by_wi, by_wo, *(by_value[name] for name in points.names)])
    worst, broken = 0.0, list[dict[str, Any]]()
    for k in range(len(points)):
        x = points.exact(k)
        expected = gradient(points.function, x)
        judged = _judged(got[k], expected, x, points)
        if not _largest(judged).ratio <= 1 and np.isfinite(got[k]).all():
            judged = _judged(got[k], _around(points, x, expected), x, points)
        one = _largest(judged)
        worst = max(worst, one.ratio)
        if not one.ratio <= 1:
            broken.append(points.told(
                k, what=f"gradient by {one.what}", ratio=one.ratio, got=one.got,
                expected=mp.nstr(one.expected, 20), relative_error=_relative(one.got, one.expected),
                bound=mp.nstr(one.bound, 5),
            ))  # fmt: skip
    return worst, broken


class Judged(NamedTuple):
    """One derivative beside its reference: the larger end where it lies beside a kink."""

    what: str
    got: float
    expected: mpf
    bound: mpf
    ratio: float


def _largest(judged: Sequence[Judged]) -> Judged:
    return max(judged, key=lambda one: one.ratio)


def _bounds(expected: Gradient, x: Sequence[mpf], names: Sequence[str], relative: float) -> list[mpf]:
    eps, size = float(np.finfo(np.float64).eps), abs(expected.value)
    found: list[mpf] = []
    for k, v in enumerate(x):
        largest = max(abs(expected.low[k]), abs(expected.high[k]))
        # A direction's own scale is 1, a width's the width.
        width = k >= 6 and domain.plain_name(names[k - 6]) in WIDTHS
        scale = abs(v) if width else max(mpf(1), abs(v))
        rounded = 8 * eps * (expected.uncertainty[k] + size / scale)
        series = relative * size / scale if relative == SERIES_GRADIENT else 0.0
        unresolved = UNRESOLVED * size / (abs(v) or 1)
        found.append(relative * largest + series + rounded + unresolved + mpf(GRADIENT_FLOOR))
    return found


def _judged(got: Floats, expected: Gradient, x: Sequence[mpf], points: Points) -> list[Judged]:
    """Every derivative beside its reference; of a direction the tangential part where the raw one is off."""
    whats = [*COMPONENTS, *points.names]
    bounds = _bounds(expected, x, points.names, points.gradient_bound)
    rows = zip(whats, got, expected.low, expected.high, bounds, strict=True)
    found = [
        Judged(what, float(g), max(low, high, key=abs), bound, _ratio(float(g), low, high, bound))
        for what, g, low, high, bound in rows
    ]
    for start in (0, 3):
        part = slice(start, start + 3)
        raw = found[part]
        if np.isfinite(got[part]).all() and _largest(raw).ratio > 1:
            tangential = _tangential(raw, expected.low[part], expected.high[part], x[part])
            found[part] = min(raw, tangential, key=lambda judged: _largest(judged).ratio)
    return found


def _tangential(
    raw: Sequence[Judged], low: Sequence[mpf], high: Sequence[mpf], w: Sequence[mpf]
) -> list[Judged]:
    """The same with gradient and bounds projected on the plane across w."""
    squared = mp.fsum(v * v for v in w)
    found: list[Judged] = []
    for j in range(3):
        row = [(1 if j == m else 0) - w[j] * w[m] / squared for m in range(3)]
        ends = [(r * a, r * b) for r, a, b in zip(row, low, high, strict=True)]
        got = mp.fsum(r * one.got for r, one in zip(row, raw, strict=True))
        bound = mp.fsum(abs(r) * one.bound for r, one in zip(row, raw, strict=True))
        lowest, highest = mp.fsum(min(e) for e in ends), mp.fsum(max(e) for e in ends)
        # Along the normal itself there is nothing tangential: no bound, no error.
        ratio = float(max(lowest - got, got - highest, mpf(0)) / bound) if bound else 0.0
        found.append(Judged(f"{raw[j].what}, tangential", float(got), highest, bound, ratio))
    return found


def _around(points: Points, x: Sequence[mpf], expected: Gradient) -> Gradient:
    """The same with the derivatives on both sides of a kink that lies within 8 eps of the inputs."""
    low, high = list(expected.low), list(expected.high)
    bounds = _bounds(expected, x, points.names, points.gradient_bound)
    for near in _nearby(x, float(np.finfo(np.float64).eps), 12):
        _, below, above = sides(points.function, near)
        for j in range(len(x)):
            # Further than any smooth change: a kink lies between.
            if max(above[j] - low[j], high[j] - below[j]) > 4 * bounds[j]:
                low[j], high[j] = min(low[j], below[j]), max(high[j], above[j])
    return Gradient(expected.value, low, high, expected.uncertainty)


def asked() -> tuple[str, ...]:
    """The models of the suite that have a closed form."""
    return tuple(name for name in MODELS if not _reasons(model_spec(name)))


def _reasons(spec: ModelSpec) -> list[str]:
    """Why a model is not asked; a delta inside a sum adds nothing and does no harm."""
    parts = [why for part in spec.components if part.family != "specular" for why in _reasons(part)]
    return [*([SKIPPED[spec.family]] if spec.family in SKIPPED else []), *parts]


STUDY = Study(
    name="precision",
    title="Values and gradients against 70 digits",
    claim="error <= 1e-12 + 8 eps kappa in float64, 1e-5 + 8 eps kappa in float32, gradients alike: "
    "every ratio of error to bound is at most 1",
    columns=(
        "float64 points", "float64 worst", "float64 broken", "float32 points", "float32 worst",
        "float32 broken", "gradient points", "gradient worst", "gradient broken",
    ),
    models=asked,
    judge=judge,
    skipped={name: "; ".join(why) for name in MODELS if (why := _reasons(model_spec(name)))},
)  # fmt: skip
