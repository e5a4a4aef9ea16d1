"""The reference itself, against numbers and identities that nobody here computed with it."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp, mpf

from fitter.spec import model_spec
from tests.evidence.differences import conditioning, gradient
from tests.evidence.reference import DIGITS, fresnel, has_reference, masking, ndf, reference
from tests.evidence.reference.geometry import Half, Pair
from tests.models import MODELS

Numbers = tuple[mpf, ...]


def _direction(theta: mpf, phi: mpf | int = 0) -> Numbers:
    return mp.sin(theta) * mp.cos(phi), mp.sin(theta) * mp.sin(phi), mp.cos(theta)


def _value(name: str, **values: float) -> Callable[[Numbers, Numbers], mpf]:
    spec, exact = model_spec(name), {key: mpf(v) for key, v in values.items()}
    return lambda wi, wo: reference(spec, exact, (*wi, *wo))


def _normal_albedo(f: Callable[[Numbers, Numbers], mpf], *, digits: int = 20) -> mpf:
    """Albedo at normal incidence of an isotropic model."""
    with mp.workdps(digits):
        up = _direction(mpf(0))
        inside = lambda t: f(up, _direction(t)) * mp.sin(t) * mp.cos(t)  # noqa: E731
        return 2 * mp.pi * mp.quad(inside, [0, mp.pi / 8, mp.pi / 4, mp.pi / 2])


def test_every_model_of_the_suite_has_a_reference_or_a_reason():
    from tests.evidence.precision import STUDY

    for name in MODELS:
        assert has_reference(model_spec(name)) or name in STUDY.skipped, name


@pytest.mark.measured
@pytest.mark.parametrize("kind", ["dielectric", "conductor"])
def test_fresnel_digits(shared: Path, kind: str):
    with (shared / "oracles" / f"fresnel_{kind}.csv").open() as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    assert len(rows) >= 12
    for row in rows:
        c, n = mp.cos(mp.radians(mpf(row["theta_deg"]))), mpf(row["n"])
        found = fresnel.dielectric(c, n) if kind == "dielectric" else fresnel.conductor(c, n, mpf(row["k"]))
        assert float(found) == pytest.approx(float(row["reflectance"]), abs=5.1e-7)


def test_fresnel_identities():
    with mp.workdps(DIGITS):
        n = mpf(3) / 2
        # At Brewster's angle the polarisation along the plane is gone: F = ((n^2 - 1)/(n^2 + 1))^2/2.
        brewster = fresnel.dielectric(1 / mp.sqrt(1 + n * n), n)
        assert abs(brewster - ((n * n - 1) / (n * n + 1)) ** 2 / 2) < mpf("1e-60")
        assert abs(fresnel.dielectric(mpf(1), n) - mpf("0.04")) < mpf("1e-60")
        # Transparent metals are dielectrics; the same share passes both ways; none beyond total reflection.
        transparent = fresnel.conductor(mpf("0.3"), n, mpf(0))
        assert abs(transparent - fresnel.dielectric(mpf("0.3"), n)) < mpf("1e-60")
        inner = mp.sqrt(1 - (1 - mpf("0.09")) / n**2)
        assert abs(fresnel.dielectric(mpf("0.3"), n) - fresnel.dielectric(inner, 1 / n)) < mpf("1e-60")
        assert fresnel.dielectric(mpf("0.7"), 1 / n) == 1


def test_transmitted_share_is_what_fresnel_leaves():
    from tests.evidence.reference import transmission

    with mp.workdps(DIGITS):
        c, n = mpf("0.4"), mpf("1.7")
        inner = mp.sqrt(1 - (1 - c * c) / n**2)
        found = transmission._transmitted(mpf(1), n, c, inner)
        assert abs(found - (1 - fresnel.dielectric(c, n))) < mpf("1e-60")


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("beckmann", {"alpha_x": 0.3, "alpha_y": 0.7, "psi": 0.4}), ("ggx", {"alpha": 0.5}),
        ("ggx", {"alpha_x": 0.3, "alpha_y": 0.7, "psi": 0.4}), ("blinn", {"n": 12.5}), ("blinn", {"n": 0.0}),
        ("gaussian", {"s": 0.3}), ("gaussian", {"s": 2.0}),
    ],
)  # fmt: skip
def test_distributions_integrate_to_one(kind: str, values: dict[str, float]):
    exact = {name: mpf(v) for name, v in values.items()}
    nodes, weights = np.polynomial.legendre.leggauss(32)
    total = 0.0
    for low, high in ((0.0, 0.4), (0.4, 1.0), (1.0, np.pi / 2)):
        for t, w in zip((nodes + 1) * (high - low) / 2 + low, weights * (high - low) / 2, strict=True):
            # The trapezoidal rule over the azimuth is spectrally accurate; half a turn is a period.
            for phi in np.arange(24) * np.pi / 24 if "psi" in values else [0.0]:
                d = ndf.NDFS[kind](exact, Half(*_direction(mpf(float(t)), mpf(float(phi)))))
                total += w * float(d) * np.cos(t) * np.sin(t) / (24 if "psi" in values else 1)
    assert 2 * np.pi * total == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize(
    ("kind", "values"),
    [("beckmann", {"alpha": 0.5}), ("ggx", {"alpha": 0.5}), ("blinn", {"n": 6.0}), ("gaussian", {"s": 0.4})],
)
@pytest.mark.parametrize("theta", [0.3, 1.1, 1.5])
def test_smith_projects_the_visible_area(kind: str, values: dict[str, float], theta: float):
    """Int G1 D max(0, w.m) dm = cos theta, the integral over m by a rule that knows nothing of Lambda."""
    exact = {name: mpf(v) for name, v in values.items()}
    sin, _, cos = _direction(mpf(theta))
    g1 = 1 / (1 + masking.LAMBDAS[kind](exact, sin, mpf(0), cos))
    nodes, weights = np.polynomial.legendre.leggauss(96)
    t, phi = (nodes + 1) * np.pi / 4, (nodes + 1) * np.pi / 2
    d = np.array([float(ndf.NDFS[kind](exact, Half(*_direction(mpf(float(one)))))) for one in t])
    facing = np.sin(theta) * np.sin(t)[:, None] * np.cos(phi) + np.cos(theta) * np.cos(t)[:, None]
    visible = 2 * np.sum(np.maximum(facing, 0) * weights * np.pi / 2, axis=1)
    assert float(g1) * np.sum(d * np.sin(t) * visible * weights * np.pi / 4) == pytest.approx(
        float(cos), rel=2e-4
    )


def test_blinn_masking_tail_of_every_size():
    for n in (0.0, 1.0, 30.0, 1e6):
        for cot in (1e-4, 0.02, 0.9, 1.1):
            with mp.workdps(30):
                values, m, a = {"n": mpf(n)}, mpf(cot), (mpf(n) + 3) / 2
                width = 1 / mp.sqrt(a)
                marks = [m, *(m + width * k for k in (mpf("0.1"), 1, 3, 10, 100)), mp.inf]
                moment = mp.quad(lambda q, m=m, a=a: (q - m) * (1 + q * q) ** -a, marks)
                expected = (n + 2) / (2 * mp.pi) * mp.beta(mpf(1) / 2, a) * moment / m
                found = masking.lambda_blinn(values, mpf(1), mpf(0), m)
            assert float(found) == pytest.approx(float(expected), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
def test_closed_forms_at_normal_incidence(alpha: float):
    a = mpf(alpha)
    bounded = _normal_albedo(_value("ward:bounded:no_diffuse", ks=1.0, alpha=alpha))
    assert float(bounded - (1 - a * a * (1 - mp.exp(-1 / a**2)))) == pytest.approx(0, abs=1e-12)
    if alpha == 1.0:
        ggx = _normal_albedo(_value("torrance_sparrow:ggx:smith:none:no_diffuse", ks=1.0, alpha=1.0))
        assert float(ggx - (1 - mp.log(2))) == pytest.approx(0, abs=1e-12)


def test_more_closed_forms_at_normal_incidence():
    qualitative = _normal_albedo(_value("oren_nayar", rho=0.8, sigma=0.7))
    first = 1 - 0.5 * 0.49 / (0.49 + 0.33)
    assert float(qualitative) == pytest.approx(0.8 * first, abs=1e-12)
    full = _normal_albedo(_value("oren_nayar:full", rho=0.8, sigma=0.7))
    assert float(full) == pytest.approx(0.8 * first + 0.64 * 0.17 * 0.49 / (0.49 + 0.13), abs=1e-12)
    lobe = _normal_albedo(_value("lafortune:no_diffuse", ks=0.6, gamma=np.pi / 4, n=7.5))
    assert float(lobe) == pytest.approx(0.6, abs=1e-12)
    assert float(_normal_albedo(_value("phong:no_diffuse", ks=0.6, n=7.5))) == pytest.approx(0.6, abs=1e-12)
    for n in (0.0, 1.0, 50.0):
        blinn = _normal_albedo(_value("blinn_phong:no_diffuse", ks=1.0, n=n))
        assert float(blinn) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(("mu", "albedo"), [(1, 0.77652207), (0.5, 0.86531955), (0.1, 0.97430675)])
def test_fujii_albedo(mu: float, albedo: float):
    from tests.evidence.reference.oren_nayar import fujii_albedo_loss

    sin = mp.sqrt(1 - mpf(mu) ** 2)
    assert float(1 - fujii_albedo_loss(mpf(1), sin, mpf(0), mpf(mu))) == pytest.approx(albedo, abs=1e-8)


def test_eon_keeps_all_energy_at_unit_reflectance():
    assert float(_normal_albedo(_value("oren_nayar:eon", rho=1.0, sigma=0.6))) == pytest.approx(
        1.0, abs=1e-12
    )


@pytest.mark.measured
@pytest.mark.parametrize(
    ("prefix", "name", "values"),
    [
        ("Ward 1992", "ward:no_diffuse", {"ks": 1.0, "alpha": 0.25}),
        ("Ward-Duer", "ward:duer:no_diffuse", {"ks": 1.0, "alpha": 0.25}),
        ("Beckmann height", "torrance_sparrow:smith:none:no_diffuse", {"ks": 1.0, "alpha": 0.5}),
        ("GGX separable", "torrance_sparrow:ggx:smith_separable:none:no_diffuse", {"ks": 1.0, "alpha": 0.5}),
        ("full Oren-Nayar rho=1 with ", "oren_nayar:full", {"rho": 1.0, "sigma": 1.0}),
    ],
)
def test_published_albedos_at_normal_incidence(
    shared: Path, prefix: str, name: str, values: dict[str, float]
):
    parameter = values.get("alpha", values.get("sigma"))
    with (shared / "oracles" / "directional_albedo.csv").open() as stream:
        rows = [
            row for row in csv.DictReader(stream)
            if row["model"].startswith(prefix) and float(row["parameter"]) == parameter and row["mu"] == "1"
        ]  # fmt: skip
    assert len(rows) == 1
    found = _normal_albedo(_value(name, **values))
    assert float(found) == pytest.approx(float(rows[0]["albedo"]), abs=2e-6)


@pytest.mark.parametrize("name", [name for name in MODELS if has_reference(model_spec(name))])
def test_swapping_the_directions_changes_nothing(name: str):
    from tests.evidence.precision import Points

    spec = model_spec(name)
    points = Points(spec, 4, 7, "float64")
    with mp.workdps(30):
        for k in range(4):
            x = points.exact(k)
            there, back = points.function(x), points.function([*x[3:6], *x[:3], *x[6:]])
            if x[2] * x[5] < 0:
                # Refraction: radiance gains the square of the index on the far side.
                eta = x[6 + points.names.index("eta")]
                there, back = (there / eta**2, back) if x[5] < 0 else (there, back / eta**2)
            assert abs(there - back) <= mpf("1e-18") * abs(there)


def test_differences_of_a_known_function():
    with mp.workdps(DIGITS):
        x = [mpf("0.3"), mpf("-2"), mpf(0)]
        f = lambda v: mp.exp(v[0] * v[1]) + v[2] * v[0] + abs(v[2])  # noqa: E731
        value, condition = conditioning(f, x)
        e = mp.exp(mpf("-0.6"))
        assert abs(value - e) < mpf("1e-60")
        assert abs(condition - 2 * mpf("0.6") * e) < mpf("1e-15")
        found = gradient(f, x)
        assert abs(found.low[0] + 2 * e) < mpf("1e-30")
        assert abs(found.high[1] - mpf("0.3") * e) < mpf("1e-30")
        # The kink of |x| at 0: derivatives from both sides, 0.3 -+ 1.
        assert abs(found.low[2] + mpf("0.7")) < mpf("1e-20")
        assert abs(found.high[2] - mpf("1.3")) < mpf("1e-20")
        # x0 d2/dx0^2 + x1 d2/dx0 dx1, in absolute values.
        assert abs(found.uncertainty[0] - (mpf("0.3") * 4 * e + 2 * abs(1 - mpf("0.6")) * e)) < mpf("1e-9")


def test_refraction_is_found_where_snell_sends_it():
    """The transmitted lobe of a smooth interface peaks at the refracted direction, not elsewhere."""
    f = _value("rough_dielectric", ks=1.0, kt=1.0, eta=1.5, alpha=0.01)
    theta, wi = mpf("0.6"), _direction(mpf("0.6"))
    inner = mp.asin(mp.sin(theta) / mpf("1.5"))
    at, beside = (f(wi, _direction(mp.pi - inner + by, mp.pi)) for by in (mpf(0), mpf("0.02")))
    assert at > 100 * beside > 0
    assert f(wi, _direction(mp.pi - inner, mpf(0))) < mpf("1e-3") * at


def test_below_the_horizon_there_is_nothing():
    for name in ("ward", "oren_nayar:full", "lambert"):
        values = {"kd": 1.0, "ks": 1.0, "alpha": 0.3, "rho": 1.0, "sigma": 0.3}
        assert _value(name, **values)(_direction(mpf("0.3")), _direction(mpf(2))) == 0


def test_layer_of_index_one_over_a_base_without_absorption_is_the_base():
    f = _value("layered(lambert)", alpha=0.3, eta=1.0, tau=0.0, base_kd=0.5)
    wi, wo = _direction(mpf("0.4")), _direction(mpf("1.0"), mpf(2))
    assert float(f(wi, wo)) == pytest.approx(0.5 / np.pi, rel=1e-12)


def test_refraction_at_the_half_vector_obeys_snell():
    from tests.evidence.reference.layered import refracted

    with mp.workdps(30):
        p = Pair(*_direction(mpf("0.4")), *_direction(mpf("1.2"), mpf(2)))
        inside = refracted(p, mpf("1.5"))
        h, c = p.half, p.cos_d
        cosine = (inside.ix * h.x + inside.iy * h.y + inside.iz * h.z) / (2 * c)
        length = mp.sqrt(inside.ix**2 + inside.iy**2 + inside.iz**2)
        assert abs(length - 1) < mpf("1e-25")
        assert abs(mp.sqrt(1 - cosine**2) * mpf("1.5") - mp.sqrt(1 - c * c)) < mpf("1e-25")


def test_wave_optics_ends_as_geometrical_optics():
    """Many wavelengths of roughness: Beckmann facets under F D S_i S_o/(4 cos cos), to first order in 1/g."""
    from tests.evidence.reference.he_torrance import _shadowing

    values = {"kd": 0.0, "sigma": 6.0, "tau": 40.0, "eta": 0.2, "kappa": 3.0}
    wi, wo = _direction(mpf("0.4")), _direction(mpf("0.7"), mpf(2))
    exact, p = {name: mpf(v) for name, v in values.items()}, Pair(*wi, *wo)
    facets = ndf.beckmann({"alpha": mpf("0.3")}, p.half) * fresnel.conductor(p.cos_d, mpf("0.2"), mpf(3))
    seen = [_shadowing(exact["sigma"], exact["tau"], *w)[0] for w in (wi, wo)]
    expected = facets * seen[0] * seen[1] / (4 * p.iz * p.oz)
    assert float(_value("he_torrance", **values)(wi, wo) / expected) == pytest.approx(1.0, abs=5e-3)


def test_wave_series_from_its_largest_term_is_the_sum_of_all():
    from tests.evidence.reference.he_torrance import _series

    for g, a in ((0.01, 3.0), (2.5, 0.0), (30.0, 400.0)):
        terms = (mpf(g) ** m * mp.exp(-g - mpf(a) / m) / (mp.factorial(m) * m) for m in range(1, 400))
        assert float(_series(mpf(g), mpf(a)) / mp.fsum(terms)) == pytest.approx(1.0, abs=1e-14)
