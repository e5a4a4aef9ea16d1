"""What integrates to one, what is symmetric, and how much light a white furnace gets back.

Of each model: its density over the hemisphere (the sphere, if it transmits), the share of ideal components
and the share of a million draws that was lost below the horizon, which together are 1; reciprocity on the
hard cases of :mod:`tests.evidence.domain`, to 1e-13 + 8 eps kappa; its albedo with all scales at 1. Of each
microfacet model's distribution: Int D cos = 1, and the projected-area identity
Int G1(o, m) D(m) max(0, o.m) dm = cos o of its masking form, which Smith's forms and V-grooves claim and the
others only approximate. All quadrature is nested Gauss-Kronrod with its own error (tests/models/cells.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fitter import models
from fitter.models import ReflectanceModel, ndf
from fitter.models.base import mixture_density
from fitter.models.masking import MASKINGS
from fitter.models.pair import Half, Pair
from fitter.spec import ModelSpec, model_spec
from tests.evidence import domain
from tests.evidence.chi_square import DRAWS, directions
from tests.evidence.study import Outcome, Study
from tests.models import MODELS, cells
from tests.models.conftest import draw
from tests.models.statistics import ideal_share

INCIDENCES = (0.0, 20.0, 45.0, 70.0, 85.0)
PAIRS = 4000
#: Cosines of the furnace's columns.
FURNACE = (1.0, 0.5, 0.1, 0.01)
AREA_COSINES = (1.0, 0.7, 0.3, 0.05)

DENSITY_OFF, UNIT_OFF, AREA_OFF = 1e-4, 1e-6, 1e-5
RECIPROCAL = 1e-13

#: A quadrature whose panels follow the directions: what its rounding leaves of slivers at grazing.
OWN_RECIPROCAL: Mapping[str, float] = {"rough_facets": 1e-8}

#: Roughness of the distributions, over what each parameter is bounded to.
ROUGHNESS: Mapping[str, tuple[Mapping[str, float], ...]] = {
    "alpha": ({"alpha": 1e-3}, {"alpha": 0.05}, {"alpha": 0.3}, {"alpha": 1.0}),
    "alpha_x": tuple({"alpha_x": a, "alpha_y": b, "psi": 0.4} for a, b in ((0.05, 0.5), (1.0, 0.1))),
    "n": ({"n": 0.1}, {"n": 10.0}, {"n": 1e3}, {"n": 1e5}),
    "s": ({"s": 1e-3}, {"s": 0.1}, {"s": 0.5}, {"s": 2.0}),
}


def judge(name: str, share: float, seed: int) -> Outcome:
    rng = np.random.default_rng([seed, *name.encode()])
    spec = model_spec(name)
    figures: dict[str, Any] = {}
    violations: list[dict[str, Any]] = []
    for of in (_density, _reciprocity, _furnace, _distribution):
        found, broken = of(spec, share, rng)
        figures |= found
        violations += broken
    return Outcome(figures, violations)


Found = tuple[dict[str, Any], list[dict[str, Any]]]


def _density(spec: ModelSpec, share: float, rng: np.random.Generator) -> Found:
    worst, violations = 0.0, list[dict[str, Any]]()
    # Few bins: the rules find the lobes by themselves from there. Behind a surface the density has a jump,
    # which coarse bins may estimate too well.
    sphere = models.family_of(spec).transmits(spec)
    theta, phi = cells.edges(90, 90, sphere) if sphere else cells.edges(18, 24)
    chosen = [degrees for degrees in INCIDENCES if rng.random() < share]
    for degrees in chosen:
        drawn = int(rng.integers(2**31))
        model = draw(spec.name, drawn)
        t = np.deg2rad(degrees)
        wi = jnp.asarray([np.sin(t) * np.cos(0.4), np.sin(t) * np.sin(0.4), np.cos(t)])
        ideal = ideal_share(model, np.asarray(wi))
        if ideal == 1.0:
            continue
        spread, error = cells.integrate(
            lambda at, m=model, i=wi: np.asarray(mixture_density(m, i, jnp.asarray(at))), theta, phi,
            absolute=1e-8, relative=1e-6,
        )  # fmt: skip
        lost = float(np.mean(~np.asarray(directions(model, wi, jax.random.key(drawn))[1])))
        off = abs(float(spread.sum()) + ideal + lost - 1.0)
        worst = max(worst, off)
        # Five standard deviations of a share of draws.
        if not off + error.sum() < DENSITY_OFF + 5 * np.sqrt(lost * (1 - lost) / DRAWS):
            violations.append({
                "what": "the density does not integrate to 1", "off": off, "lost": lost,
                "error": float(error.sum()), "theta_i_deg": degrees, "parameters_seed": drawn,
            })  # fmt: skip
    return ({"int pdf - 1": worst} if chosen else {}), violations


@eqx.filter_jit
def _both_ways(model: ReflectanceModel, values: dict[str, jax.Array], wi: jax.Array, wo: jax.Array):
    """f(wi, wo), f(wo, wi) and the conditioning sum |x df/dx| of each point."""

    def value(v: dict[str, jax.Array], i: jax.Array, o: jax.Array) -> jax.Array:
        linear = {p.name for p in model.table if p.linear}
        own = {name: x[None] if name in linear else x for name, x in v.items()}
        return type(model)(spec=model.spec, channels=("c",), values=own).value(Pair.split(i, o))[0]

    def sensitivity(v: dict[str, jax.Array], i: jax.Array, o: jax.Array) -> jax.Array:
        slopes = jax.grad(value, argnums=(0, 1, 2))(v, i, o)
        parts = jax.tree.map(lambda x, d: jnp.sum(jnp.abs(x * d)), (v, i, o), slopes)
        return sum(jax.tree.leaves(parts), start=jnp.zeros(()))

    def each(point: tuple[dict[str, jax.Array], jax.Array, jax.Array]) -> tuple[jax.Array, ...]:
        v, i, o = point
        return value(v, i, o), value(v, o, i), sensitivity(v, i, o)

    # A few at a time: some models make a table for the parameters of every point.
    return jax.lax.map(each, (values, wi, wo), batch_size=64)


def _reciprocity(spec: ModelSpec, share: float, rng: np.random.Generator) -> Found:
    kind = models.family_of(spec)
    if not kind.reciprocal(spec):
        return {"reciprocity, of its bound": "not claimed"}, []
    count = max(int(PAIRS * share), 20)
    values = domain.values(rng, models.parameter_table(spec), count, inside_too=False)
    wi, wo, _ = domain.directions(rng, domain.lobe_width(values, count))
    model = models.create(spec.name)
    kept = {name: jnp.asarray(v) for name, v in values.items()}
    there, back, sensitivity = (
        np.asarray(x) for x in _both_ways(model, kept, jnp.asarray(wi), jnp.asarray(wo))
    )
    tiny, eps = np.finfo(float).tiny, np.finfo(float).eps
    relative = OWN_RECIPROCAL.get(spec.family, RECIPROCAL)
    bound = relative * np.abs(there) + 8 * eps * sensitivity + tiny
    ratio = np.abs(there - back) / bound
    violations = [
        {"what": "f(wi, wo) is not f(wo, wi)", "ratio": float(ratio[k]),
         "wi": wi[k].tolist(), "wo": wo[k].tolist(),
         **{name: float(v[k]) for name, v in values.items()}}
        for k in np.flatnonzero(~(ratio <= 1.0))[:5]
    ]  # fmt: skip
    return {"reciprocity, of its bound": float(ratio.max())}, violations


def _furnace(spec: ModelSpec, share: float, rng: np.random.Generator) -> Found:
    """The model's default roughness, every scale and reflectance at 1, nothing diffuse beside a lobe."""
    del rng
    if share < 1:
        return {}, []
    table = models.parameter_table(spec)
    scales = {p.name: 1.0 for p in table if p.linear}
    if any(name.endswith("ks") or "ks_" in name for name in scales):
        scales |= {name: 0.0 for name in scales if name.endswith("kd")}
    model = models.create(spec.name, **scales)
    found = {}
    for mu in FURNACE:
        wi = np.array([np.sqrt((1 - mu) * (1 + mu)), 0.0, mu])
        total = float(model.albedo(wi)[0])
        if model.transmits(spec):
            total += float(model.transmittance(wi)[0])
        found[f"E({mu:g})"] = total
    broken = [k for k, v in found.items() if not np.isfinite(v)]
    return found, [{"what": f"{k} is not finite"} for k in broken]


def _distribution(spec: ModelSpec, share: float, rng: np.random.Generator) -> Found:
    if spec.family != "torrance_sparrow":
        return {}, []
    names = [p.name for p in ndf.parameters(spec)]
    unit, area, violations = 0.0, 0.0, list[dict[str, Any]]()
    claims = spec.masking in ("smith", "smith_separable", "v_groove")
    chosen = [rough for rough in ROUGHNESS[names[0]] if rng.random() < share]
    for rough in chosen:
        values = {name: jnp.asarray(v) for name, v in rough.items()}
        off = abs(_facets(spec, values, None) - 1.0)
        unit = max(unit, off)
        if not off < UNIT_OFF:
            violations.append({"what": "Int D cos is not 1", "off": off, **rough})
        # A width far below the nodes' spacing makes every masking form 1.
        for mu in AREA_COSINES:
            off = abs(_facets(spec, values, mu) / mu - 1.0)
            area = max(area, off)
            if claims and not off < AREA_OFF:
                violations.append({"what": "the projected area is not cos", "off": off, "cos": mu, **rough})
    return ({"int D cos - 1": unit, "area/cos - 1": area} if chosen else {}), violations


@eqx.filter_jit
def _seen(spec: ModelSpec, values: dict[str, jax.Array], m: jax.Array, o: jax.Array) -> jax.Array:
    """G1(o, m) D(m) max(0, o.m)."""
    normals = ndf.of(spec, values)
    facing = jnp.maximum(m @ o, 0.0)
    d = normals.density(Half(m[:, 0], m[:, 1], m[:, 2], jnp.ones_like(facing)))
    if spec.masking == "v_groove":
        g1 = jnp.minimum(1.0, 2.0 * m[:, 2] * o[2] / jnp.where(facing > 0, facing, 1.0))
    else:
        # With one direction on the normal, which nothing masks, the pair's G is G1 of the other.
        zero, one = jnp.zeros(()), jnp.ones(())
        pair = Pair(zero, zero, one, o[0], o[1], o[2])
        g1 = 4.0 * o[2] * MASKINGS[spec.masking or ""](pair, Half.of(pair), normals)
    return g1 * d * facing


@eqx.filter_jit
def _upright(spec: ModelSpec, values: dict[str, jax.Array], m: jax.Array) -> jax.Array:
    return ndf.of(spec, values).density(Half(m[:, 0], m[:, 1], m[:, 2], jnp.ones(len(m)))) * m[:, 2]


def _facets(spec: ModelSpec, values: dict[str, jax.Array], mu: float | None) -> float:
    """Int D cos, or for a direction of cosine mu the projected area of the facets that it sees."""
    o = None if mu is None else jnp.asarray([np.sqrt(1 - mu * mu), 0.0, mu])

    def density(m: np.ndarray) -> np.ndarray:
        at = jnp.asarray(m)
        return np.asarray(_upright(spec, values, at) if o is None else _seen(spec, values, at, o))

    theta = np.concatenate([[0.0], np.geomspace(1e-6, np.pi / 2, 48)])
    found, _ = cells.integrate(density, theta, np.linspace(0, 2 * np.pi, 13), absolute=1e-10, relative=1e-7)
    return float(found.sum())


STUDY = Study(
    name="normalisation",
    title="Normalisation, reciprocity and white furnace",
    claim=(
        f"Densities integrate to 1 within {DENSITY_OFF:g} (with what {DRAWS:,} draws lose at the horizon), "
        f"distributions within {UNIT_OFF:g}; masking by Smith and by V-grooves keeps the projected area to "
        f"{AREA_OFF:g} (for other forms the figure says how far off they are); f(wi, wo) = f(wo, wi) to "
        f"{RECIPROCAL:g} + 8 eps kappa (rough_facets: 1e-8). E is the albedo (and transmittance) at the "
        "default roughness with every scale at 1 and no diffuse term beside a lobe"
    ),
    columns=(
        "int pdf - 1", "reciprocity, of its bound", *(f"E({mu:g})" for mu in FURNACE), "int D cos - 1",
        "area/cos - 1",
    ),
    models=lambda: MODELS,
    judge=judge,
)  # fmt: skip
