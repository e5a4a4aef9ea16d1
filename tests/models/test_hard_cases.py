"""The catalogue of docs/hard-cases.md: a naive form shown wrong, ours right, the page's figures true.

Every test writes the naive form out as a textbook or a quick port has it, in the precision it would run in.
The right value is 50-digit arithmetic on the same stored numbers (tests/evidence/reference) or a closed form.
"""

from __future__ import annotations

import importlib
import inspect
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf

from fitter import SpecError, models
from fitter.models import fresnel, ndf
from fitter.models.lobes import sample_mixture
from fitter.models.oren_nayar import OrenNayar
from fitter.models.pair import Pair
from fitter.models.phong_lobe import PhongLobe
from fitter.models.roughness import Isotropic
from fitter.spec import model_spec
from tests.evidence.reference import DIGITS, reference
from tests.evidence.reference import fresnel as exact_fresnel
from tests.evidence.reference.oren_nayar import fujii_albedo_loss

PAGE = Path(__file__).resolve().parents[2] / "docs" / "hard-cases.md"
ROW = re.compile(r"^\| (H\d+) \|(.*)\|$", re.MULTILINE)
BAR = re.compile(r"(?<!\\)\|")
NORMAL = np.array([0.0, 0.0, 1.0])


def rows() -> dict[str, list[str]]:
    """The cells behind the id of each row: case, why, naive, ours, test."""
    return {
        name: [cell.strip() for cell in BAR.split(cells)] for name, cells in ROW.findall(PAGE.read_text())
    }


def shown(case: str, *, naive: float, ours: float) -> None:
    """The page's row says what was just measured, to three digits."""
    _, _, printed_naive, printed_ours, _ = rows()[case]
    for value, cell in ((naive, printed_naive), (ours, printed_ours)):
        text = f"{float(value) + 0.0:.3g}"
        assert re.search(rf"(?<![\w.+-]){re.escape(text)}(?![\w.])", cell), (
            f"{case}: {text} is not in {cell!r}"
        )


def direction(theta: float, phi: float = 0.0) -> np.ndarray:
    return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])


def grazing(mu: float, phi: float = 0.0) -> np.ndarray:
    s = math.sqrt(1 - mu * mu)
    return np.array([s * math.cos(phi), s * math.sin(phi), mu])


def stored(*arrays: np.ndarray, dtype: type = np.float32) -> list[np.ndarray]:
    return [np.asarray(a, dtype) for a in arrays]


def ours(name: str, wi: np.ndarray, wo: np.ndarray, **values: float) -> float:
    """Our value in the dtype of the directions."""
    found = models.create(name, **values).evaluate(wi, wo)
    assert found.dtype == wi.dtype
    return float(found[0])


def exact(name: str, wi: np.ndarray, wo: np.ndarray, **values: float) -> float:
    """The same in 50 digits, of the directions and parameters as stored in their dtype."""
    with mp.workdps(DIGITS):
        kept = {k: mpf(float(wi.dtype.type(v))) for k, v in values.items()}
        return float(reference(model_spec(name), kept, [mpf(float(x)) for x in (*wi, *wo)]))


def close(found: float, right: float, relative: float) -> bool:
    """pytest.approx would take anything below 1e-12 as equal."""
    return abs(found - right) <= relative * abs(right)


def gradients(name: str, wi: np.ndarray, wo: np.ndarray, **values: float) -> np.ndarray:
    """All derivatives of our value, to both directions and to the parameters."""
    model = models.create(name, **values)

    def value(v: dict[str, jax.Array], i: jax.Array, o: jax.Array) -> jax.Array:
        return type(model)(spec=model.spec, channels=model.channels, values=v).evaluate(i, o)[0]

    found = slope_of(value, argnums=(0, 1, 2))(model.values, jnp.asarray(wi), jnp.asarray(wo))
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(found)])


def slope_of(f: Callable[..., jax.Array], argnums: int | tuple[int, ...] = 0) -> Callable[..., Any]:
    """The derivative as one program: operation by operation each would be compiled for itself."""
    return jax.jit(jax.grad(f, argnums=argnums))


def half32(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """The half vector normalised, as every textbook begins."""
    h = wi + wo
    return h / np.sqrt(h @ h)


# Mirror-like and nearly so ----------------------------------------------------------------------------


def ggx_of_cosine(c: np.float32, alpha: float) -> np.float32:
    a2 = np.float32(alpha) ** 2
    with np.errstate(all="ignore"):
        return a2 / (np.float32(np.pi) * (c * c * (a2 - np.float32(1)) + np.float32(1)) ** 2)


def test_h01():
    alpha = 1e-3
    wi, wo = stored(direction(0.5), direction(0.5 + 2 * alpha, math.pi))
    naive = ggx_of_cosine(half32(wi, wo)[2], alpha) / (4 * wi[2] * wo[2])
    name, values = "torrance_sparrow:ggx:none:no_diffuse", {"ks": 1.0, "alpha": alpha}
    right = exact(name, wi, wo, **values)
    assert abs(naive / right - 1) > 0.02
    assert close(ours(name, wi, wo, **values), right, 1e-3)  # kappa of this pair is 500
    shown("H01", naive=naive, ours=ours(name, wi, wo, **values))


def test_h02():
    wi, wo = stored(direction(0.5), direction(0.5) * [-1, 1, 1])
    naive = ggx_of_cosine(half32(wi, wo)[2], 1e-4) / (4 * wi[2] * wo[2])
    name, values = "torrance_sparrow:ggx:none:no_diffuse", {"ks": 1.0, "alpha": 1e-4}
    right = exact(name, wi, wo, **values)
    assert not np.isfinite(naive)
    assert close(ours(name, wi, wo, **values), right, 1e-5)
    shown("H02", naive=naive, ours=ours(name, wi, wo, **values))


def test_h03():
    alpha = 1e-4
    wi, wo = stored(NORMAL, np.array([2e-4, 0.0, 1.0]))
    c = half32(wi, wo)[2]
    naive = np.exp(-(1 / (c * c) - np.float32(1)) / np.float32(alpha) ** 2) / (4 * np.pi * alpha**2)
    name, values = "ward:no_diffuse", {"ks": 1.0, "alpha": alpha}
    right = exact(name, wi, wo, **values)
    assert naive / right > 2
    assert close(ours(name, wi, wo, **values), right, 1e-5)
    shown("H03", naive=naive, ours=ours(name, wi, wo, **values))


def test_h04():
    def naive(o: jax.Array) -> jax.Array:
        h = (jnp.asarray(NORMAL) + o) / jnp.linalg.norm(jnp.asarray(NORMAL) + o)
        phi, tan2 = jnp.arctan2(h[1], h[0]), (1 - h[2] ** 2) / h[2] ** 2
        return jnp.exp(-tan2 * ((jnp.cos(phi) / 0.1) ** 2 + (jnp.sin(phi) / 0.3) ** 2))

    slope = float(slope_of(naive)(jnp.asarray(NORMAL))[0])
    found = gradients("ward:anisotropic", NORMAL, NORMAL, alpha_x=0.1, alpha_y=0.3)
    assert np.isnan(slope)
    assert np.isfinite(found).all()
    tilt = float(slope_of(lambda x: models.create("ward:anisotropic").evaluate(
        jnp.asarray(NORMAL), jnp.stack([x, 0.0, 1.0]))[0])(0.0))  # fmt: skip
    shown("H04", naive=slope, ours=tilt)


def test_h05():
    wi, wo = stored(direction(0.5), direction(0.503))
    h = half32(wi, wo)
    facets = exact("torrance_sparrow:ggx:none:no_diffuse", wi, wo, ks=1.0, alpha=0.5)
    naive = (np.float32(1) - np.float32(h @ wi)) ** 5 * facets
    name, values = "torrance_sparrow:ggx:no_diffuse", {"ks": 1.0, "alpha": 0.5, "f0": 0.0}
    right = exact(name, wi, wo, **values)
    assert abs(naive / right - 1) > 0.05
    # The difference of two stored directions is known to 1e-4 of itself; kappa says so.
    assert close(ours(name, wi, wo, **values), right, 1e-5)
    shown("H05", naive=naive, ours=ours(name, wi, wo, **values))


def test_h06():
    n = 1e6
    wi, wo = stored(NORMAL, direction(2e-3))
    c = half32(wi, wo)[2]
    naive = c ** np.float32(n) * np.float32((n + 2) * (n + 4) / (8 * np.pi * n))
    right = exact("blinn_phong:no_diffuse", wi, wo, ks=1.0, n=n)
    assert abs(naive / right - 1) > 0.01
    found = ours("blinn_phong:no_diffuse", wi, wo, ks=1.0, n=n)
    assert close(found, right, 1e-5)
    shown("H06", naive=naive, ours=found)


def test_h07():
    n, c = 16_600.0, 0.577
    wi = np.array([0.6, 0.0, 0.8])
    wo = wi * [-1, 1, 1]
    with np.errstate(all="ignore"):
        base = np.maximum(0.0, -c * (wi[0] * wo[0]) + c * wi[2] * wo[2])
        naive = (n + 2) / (2 * np.pi * np.float64(c) ** n) * base**n
    found = ours("lafortune:no_diffuse", wi, wo, ks=1.0, n=n, gamma=math.pi / 4)
    assert np.isnan(naive)
    assert close(found, (n + 2) / (2 * np.pi), 1e-11)
    shown("H07", naive=naive, ours=found)


# Powers -----------------------------------------------------------------------------------------------


def test_h08():
    wi = direction(1.2)
    base = np.float64(-wi[0] * wi[0] + wi[2] * wi[2])
    with np.errstate(all="ignore"):
        naive = base**2.5
    found = ours("phong:no_diffuse", wi, wi, ks=1.0, n=2.5)
    assert np.isnan(naive)
    assert found == 0.0
    shown("H08", naive=naive, ours=found)


def test_h09():
    slope = float(slope_of(lambda x: jnp.where(x > 0, x**2.5, 0.0))(-0.7))
    found = gradients("phong:no_diffuse", direction(1.2), direction(1.2), ks=1.0, n=2.5)
    assert np.isnan(slope)
    np.testing.assert_array_equal(found, 0.0)
    shown("H09", naive=slope, ours=found.max())


def test_h10():
    w = np.array([0.5, 0.0, 0.5])  # not of unit length: R(wi).wo is 0 exactly, however it is rounded
    slope = float(slope_of(lambda x: jnp.maximum(x, 0.0) ** 0.1)(float(w[2] * w[2] - w[0] * w[0])))
    found = gradients("phong:no_diffuse", w, w, ks=1.0, n=0.1)
    assert np.isinf(slope)
    np.testing.assert_array_equal(found, 0.0)
    shown("H10", naive=slope, ours=found.max())


# Azimuths and angles that do not exist ----------------------------------------------------------------


def test_h11():
    wo, sigma = direction(0.7), 0.5
    with np.errstate(all="ignore"):
        cos_dphi = NORMAL[:2] @ wo[:2] / (np.hypot(*NORMAL[:2]) * np.hypot(*wo[:2]))
    s2 = sigma**2
    b = 0.45 * s2 / (s2 + 0.09)
    naive = (1 - 0.5 * s2 / (s2 + 0.33) + b * np.maximum(0, cos_dphi) * np.sin(0.7) * np.tan(0.0)) / np.pi
    found = ours("oren_nayar", NORMAL, wo, rho=1.0, sigma=sigma)
    assert np.isnan(naive)
    assert found == pytest.approx((1 - 0.5 * s2 / (s2 + 0.33)) / np.pi, rel=1e-14)
    shown("H11", naive=naive, ours=found)


def test_h12():
    wo = jnp.asarray(direction(0.7))

    def naive(i: jax.Array) -> jax.Array:
        dphi = jnp.arctan2(i[1], i[0]) - jnp.arctan2(wo[1], wo[0])
        s_i, s_o = jnp.hypot(i[0], i[1]), jnp.hypot(wo[0], wo[1])
        return jnp.maximum(0.0, jnp.cos(dphi)) * s_i * s_o / jnp.maximum(i[2], wo[2])

    slope = float(slope_of(naive)(jnp.asarray(NORMAL))[0])
    found = gradients("oren_nayar", NORMAL, np.asarray(wo), rho=1.0, sigma=0.5)
    assert np.isnan(slope)
    assert np.isfinite(found).all()
    model = models.create("oren_nayar", rho=1.0, sigma=0.5)
    tilt = float(slope_of(lambda x: model.evaluate(jnp.stack([x, 0.0, 1.0]), wo)[0])(1e-9))
    # B sin(theta_o)/pi on the side of wo.
    assert tilt == pytest.approx(0.45 * 0.25 / 0.34 * math.sin(0.7) / math.pi, rel=1e-6)
    shown("H12", naive=slope, ours=tilt)


def test_h13():
    slope = float(slope_of(lambda z: jnp.arccos(z))(1.0))
    found = gradients("oren_nayar:full", NORMAL, direction(0.7), rho=1.0, sigma=0.5)
    assert np.isinf(slope)
    assert np.isfinite(found).all()
    model = models.create("oren_nayar:full", rho=1.0, sigma=0.5)
    found = float(
        slope_of(lambda z: model.evaluate(jnp.stack([0.0, 0.0, z]), jnp.asarray(direction(0.7)))[0])(1.0)
    )
    shown("H13", naive=slope, ours=found)


def test_h14():
    wi = jnp.asarray(direction(0.7))

    def naive(o: jax.Array) -> jax.Array:
        h = wi + o
        h = h / jnp.linalg.norm(h)
        return jnp.where(o[2] > 0, jnp.exp(-(h[0] ** 2 + h[1] ** 2) / h[2] ** 2), 0.0)

    slope = float(slope_of(naive)(-wi)[0])
    found = gradients("ward", np.asarray(wi), -np.asarray(wi))
    assert np.isnan(slope)
    np.testing.assert_array_equal(found, 0.0)
    shown("H14", naive=slope, ours=found.max())


# Grazing ----------------------------------------------------------------------------------------------


def test_h15():
    wi, wo = stored(grazing(1e-6), grazing(1e-6, math.pi - 1e-4))
    h = half32(wi, wo)
    name, values = "torrance_sparrow:ggx:none:no_diffuse", {"ks": 1.0, "alpha": 0.5}
    with np.errstate(all="ignore"):
        g = np.minimum(1.0, 2 * h[2] * np.minimum(wi[2], wo[2]) / np.float32(h @ wi))
    right = exact(name, wi, wo, **values)
    # All else of the naive form is taken as exact.
    c = float(np.linalg.norm(wi.astype(float) + wo.astype(float)) / 2)
    true_g = min(1.0, 2 * float(wi[2] + wo[2]) / (2 * c) * float(wi[2]) / c)
    naive = right / true_g * g
    assert abs(naive / right - 1) > 1e-3
    assert close(ours(name, wi, wo, **values), right, 1e-5)
    shown("H15", naive=naive, ours=ours(name, wi, wo, **values))


def test_h16():
    wi, wo = stored(grazing(1e-6), grazing(1e-6, 2.0))

    def single(function, x):
        """Rounded as it should be: NumPy's own float32 functions differ from processor to processor."""
        return np.float32(function(float(x)))

    a, b = single(math.acos, wi[2]), single(math.acos, wo[2])
    sigma, rho = np.float32(0.5), 1.0
    s2 = sigma**2
    q, cos_dphi = s2 / (s2 + np.float32(0.09)), np.float32(math.cos(2.0))
    c1 = 1 - 0.5 * s2 / (s2 + 0.33)
    c2 = 0.45 * q * (single(math.sin, a) - (2 * b / np.float32(np.pi)) ** 3)
    c3 = 0.125 * q * (4 * a * b / np.float32(np.pi) ** 2) ** 2
    l1 = c1 + cos_dphi * c2 * single(math.tan, b)
    l1 += (1 - np.abs(cos_dphi)) * c3 * single(math.tan, (a + b) / 2)
    naive = float(rho / np.pi * l1)
    right = exact("oren_nayar:full", wi, wo, rho=rho, sigma=0.5)
    found = ours("oren_nayar:full", wi, wo, rho=rho, sigma=0.5)
    assert abs(naive / right - 1) > 0.02
    assert close(found, right, 1e-5)
    shown("H16", naive=naive, ours=found)


def test_h17():
    alpha = 0.5
    wi, wo = stored(grazing(1e-8), grazing(1e-8, 1.0))

    def naive(o: jax.Array) -> jax.Array:
        h = wi + o
        c = h[2] / jnp.sqrt(h @ h)
        return jnp.exp(-(1 - c * c) / (c * c) / alpha**2) / (math.pi * alpha**2 * c**4)

    slope = float(slope_of(naive)(jnp.asarray(wo))[2])
    found = gradients("torrance_sparrow:none:no_diffuse", wi, wo, ks=1.0, alpha=alpha)
    assert np.isnan(slope)
    np.testing.assert_array_equal(found, 0.0)
    # Of any roughness where cosines are at least 1e-6.
    inside = stored(grazing(1e-6), grazing(1e-6, 1.0))
    assert np.isfinite(gradients("torrance_sparrow:none:no_diffuse", *inside, ks=1.0, alpha=1e-4)).all()
    shown("H17", naive=slope, ours=found.max())


def test_h18():
    wi, wo = stored(grazing(1e-6), grazing(1e-6, 2.0))
    h = half32(wi, wo)
    alpha = np.float32(1e-4)
    with np.errstate(all="ignore"):
        tan2 = (h[0] ** 2 + h[1] ** 2) / h[2] ** 2
        d = (1 + tan2) ** 2 / (np.float32(np.pi) * alpha**2 * (1 + tan2 / alpha**2) ** 2)
    name, values = "torrance_sparrow:ggx:none:no_diffuse", {"ks": 1.0, "alpha": 1e-4}
    right = exact(name, wi, wo, **values)
    naive = float(d) * right
    assert naive == 0.0
    assert right > 0
    assert close(ours(name, wi, wo, **values), right, 1e-5)
    shown("H18", naive=naive, ours=ours(name, wi, wo, **values))


def test_h19():
    def naive(theta: jax.Array) -> jax.Array:
        a = 1 / (0.3 * jnp.tan(theta))
        lam = (jax.scipy.special.erf(a) - 1) / 2 + jnp.exp(-a * a) / (2 * a * math.sqrt(math.pi))
        return 1 / (1 + lam)

    slope = float(slope_of(naive)(0.0))
    found = gradients("torrance_sparrow:smith", NORMAL, direction(0.7), alpha=0.3)
    assert np.isnan(slope)
    assert np.isfinite(found).all()
    model = ndf.Beckmann(Isotropic(jnp.asarray(0.3)))
    tilt = float(slope_of(lambda x: model.lambda_cos(x, jnp.asarray(0.0), jnp.asarray(1.0)))(0.0))
    assert tilt == 0.0
    shown("H19", naive=slope, ours=tilt)


def test_h20():
    wi, wo = stored(np.array([1.0, 0.0, 1e-20]), direction(0.5, 2.0))
    alpha = np.float32(0.5)
    with np.errstate(all="ignore"):
        tan2 = (wi[0] / wi[2]) ** 2
        lam = (np.sqrt(1 + alpha**2 * tan2) - 1) / 2
        naive = 1 / (1 + lam) / (4 * wi[2] * wo[2])
    name, values = "torrance_sparrow:ggx:smith:none:no_diffuse", {"ks": 1.0, "alpha": 0.5}
    right = exact(name, wi, wo, **values)
    assert naive == 0.0
    assert close(ours(name, wi, wo, **values), right, 1e-5)
    shown("H20", naive=naive, ours=ours(name, wi, wo, **values))


def test_h21():
    def naive(x: jax.Array) -> jax.Array:
        a = 1 / (0.3 * jnp.abs(x))
        return jnp.where(a < 1.6, (3.535 * a + 2.181 * a * a) / (1 + 2.276 * a + 2.577 * a * a), 1.0)

    slope = float(slope_of(naive)(0.0))
    found = gradients("torrance_sparrow:rational:none:no_diffuse", NORMAL, NORMAL, ks=1.0, alpha=0.3)
    assert np.isnan(slope)
    assert np.isfinite(found).all()
    shown("H21", naive=slope, ours=float(found[2]))


def test_h22():
    alpha = 1e-3
    wi, wo = stored(NORMAL, direction(2 * math.atan(math.sqrt(90.0) * alpha)))
    # Written as the formula reads; XLA on a CPU takes numbers below 1.2e-38 for 0.
    naive = float(jax.jit(lambda t, z: jnp.exp(-t) / z)(np.float32(90.0), np.float32(4 * np.pi * alpha**2)))
    right = exact("ward:duer:no_diffuse", wi, wo, ks=1.0, alpha=alpha)
    found = ours("ward:duer:no_diffuse", wi, wo, ks=1.0, alpha=alpha)
    assert naive == 0.0
    assert right > 1e-36
    # kappa is some 4 slope2 here.
    assert close(found, right, 3e-4)
    shown("H22", naive=naive, ours=found)


# Fresnel ----------------------------------------------------------------------------------------------


def test_h23():
    c, eta = 0.5, 1 / 1.5
    with np.errstate(all="ignore"):
        g = np.sqrt(np.float64(eta**2 - 1 + c * c))
    naive = ((c - g) / (c + g)) ** 2
    found = float(fresnel.dielectric(jnp.asarray(c), jnp.asarray(eta)))
    assert np.isnan(naive)
    assert found == 1.0
    shown("H23", naive=naive, ours=found)


def test_h24():
    def naive(c: jax.Array, eta: jax.Array) -> jax.Array:
        g2 = eta * eta - 1 + c * c
        g = jnp.sqrt(g2)
        return jnp.where(g2 > 0, ((c - g) / (c + g)) ** 2, 1.0)

    point = (jnp.asarray(0.5), jnp.asarray(1 / 1.5))
    slope = float(slope_of(naive)(*point))
    found = [float(x) for x in slope_of(fresnel.dielectric, argnums=(0, 1))(*point)]
    assert np.isnan(slope)
    assert found == [0.0, 0.0]
    shown("H24", naive=slope, ours=found[0])


def test_h25():
    c, eta = np.float32(0.7), np.float32(1 + 2.4e-7)
    g = np.sqrt(eta * eta - 1 + c * c)
    naive = float(((c - g) / (c + g)) ** 2 + ((eta**2 * c - g) / (eta**2 * c + g)) ** 2) / 2
    with mp.workdps(DIGITS):
        right = float(exact_fresnel.dielectric(mpf(float(c)), mpf(float(eta))))
    found = float(fresnel.dielectric(jnp.asarray(c), jnp.asarray(eta)))
    assert abs(naive / right - 1) > 0.02
    assert close(found, right, 1e-5)
    shown("H25", naive=naive, ours=found)


def test_h26():
    c, n, k = np.float32(0.5), np.float32(0.01), np.float32(20)
    q = n * n - k * k - (1 - c * c)
    modulus = np.sqrt(q * q + 4 * n * n * k * k)
    a = np.sqrt(np.maximum(0, (modulus + q) / 2))
    across = ((a - c) ** 2 + (modulus - q) / 2) / ((a + c) ** 2 + (modulus - q) / 2)
    s2 = 1 - c * c
    t = s2 / c
    along = across * ((a - t) ** 2 + (modulus - q) / 2) / ((a + t) ** 2 + (modulus - q) / 2)
    naive = 1 - float(across + along) / 2
    with mp.workdps(DIGITS):
        right = float(1 - exact_fresnel.conductor(mpf(float(c)), mpf(float(n)), mpf(float(k))))
    found = 1 - float(fresnel.conductor(jnp.asarray(c), jnp.asarray(n), jnp.asarray(k)))
    assert abs(naive / right - 1) > 0.02
    assert found == pytest.approx(right, abs=1.2e-7)
    shown("H26", naive=naive, ours=found)


def test_h27():
    gold = 1.022
    naive = gold
    with pytest.raises(SpecError, match="outside") as caught:
        models.create("torrance_sparrow", f0=[gold, 0.782, 0.344])
    assert caught.value.parameter == "f0"
    model = models.create("torrance_sparrow", f0=1.0)
    shown("H27", naive=naive, ours=float(model.values["f0"][0]))


# Exponents and normalisations -------------------------------------------------------------------------


def test_h28():
    nu, nv = 10.0, 1000.0

    def naive(h: jax.Array) -> jax.Array:
        return h[2] ** ((nu * h[0] ** 2 + nv * h[1] ** 2) / (1 - h[2] ** 2))

    slope = float(slope_of(naive)(jnp.asarray(NORMAL))[0])
    values = {"rd": 0.0, "rs": 1.0, "nu": nu, "nv": nv, "psi": 0.0}
    found = ours("ashikhmin_shirley", NORMAL, NORMAL, **values)
    slopes = gradients("ashikhmin_shirley", NORMAL, NORMAL, **values)
    assert np.isnan(slope)
    assert found == pytest.approx(math.sqrt((nu + 1) * (nv + 1)) / (8 * math.pi), rel=1e-13)
    assert np.isfinite(slopes).all()
    model = models.create("ashikhmin_shirley", **values)
    tilt = float(slope_of(lambda x: model.evaluate(jnp.asarray(NORMAL), jnp.stack([x, 0.0, 1.0]))[0])(0.0))
    assert tilt == pytest.approx(0.0, abs=1e-12)
    shown("H28", naive=slope, ours=0.0)


def test_h29():
    wi, wo, sigma, rho = direction(0.5), direction(0.7, 2.0), 0.0, 0.8
    with np.errstate(all="ignore"):
        average = 1.0
        loss = np.float64(0.0)
        multiple = (
            rho**2 * average / (1 - rho * (1 - average)) / np.pi * loss * loss / (1 - np.float64(average))
        )
    naive = rho / np.pi + multiple
    found = ours("oren_nayar:eon", wi, wo, rho=rho, sigma=sigma)
    assert np.isnan(naive)
    assert found == pytest.approx(rho / np.pi, rel=1e-14)
    assert np.isfinite(gradients("oren_nayar:eon", wi, wo, rho=rho, sigma=sigma)).all()
    shown("H29", naive=naive, ours=found)


def test_h30():
    (wi,) = stored(grazing(1e-4))
    k1, k2 = 1 / 2 - 2 / (3 * math.pi), 2 / 3 - 28 / (15 * math.pi)
    mu, one = wi[2], np.float32(1)
    s = np.sqrt(one - mu * mu)
    g = s * (np.arccos(mu) - s * mu) + np.float32(2 / 3) * (s * (one - s**3) / mu - s)
    loss = float(one - (one + g / np.float32(np.pi)) / np.float32(1 + k1))
    average_loss = 1 - (1 + k2) / (1 + k1)
    naive = loss**2 / (average_loss * math.pi)
    with mp.workdps(DIGITS):
        mu = mpf(float(wi[2]))
        right = float(fujii_albedo_loss(mpf(1), mp.sqrt(1 - mu * mu), mpf(0), mu)) ** 2 / (
            average_loss * math.pi
        )
    # The term of the multiply scattered light.
    spec = model_spec("oren_nayar:eon")
    sigma = {"sigma": jnp.asarray(1.0, jnp.float32)}
    found = float(OrenNayar.terms(spec, sigma, Pair.split(wi, wi))[-1])
    assert abs(naive / right - 1) > 0.5
    assert close(found, right, 1e-5)
    shown("H30", naive=naive, ours=found)


def test_h31():
    s = 1e-3
    theta = np.deg2rad(np.arange(0.0, 91.0))
    weight = 2 * np.pi * np.trapezoid(np.exp(-((theta / s) ** 2)) * np.sin(theta) * np.cos(theta), theta)
    naive = 1 / weight
    name = "torrance_sparrow:gaussian:none:no_diffuse"
    # 4 f is D at the mirror direction of the normal.
    found = 4 * ours(name, NORMAL, NORMAL, ks=1.0, s=s)
    right = 4 * exact(name, NORMAL, NORMAL, ks=1.0, s=s)
    assert naive / right > 1e100
    assert close(found, right, 1e-11)
    shown("H31", naive=naive, ours=found)


def test_h32():
    s = 1e-3
    wi, wo = stored(NORMAL, direction(2 * s))
    naive_angle = np.arccos(half32(wi, wo)[2])
    peak = exact("torrance_sparrow:gaussian:none:no_diffuse", *stored(NORMAL, NORMAL), ks=1.0, s=s)
    naive = peak * math.exp(-(float(naive_angle / np.float32(s)) ** 2))
    values = {"ks": 1.0, "s": s}
    right = exact("torrance_sparrow:gaussian:none:no_diffuse", wi, wo, **values)
    found = ours("torrance_sparrow:gaussian:none:no_diffuse", wi, wo, **values)
    assert abs(naive / right - 1) > 0.01
    assert close(found, right, 1e-5)
    shown("H32", naive=naive, ours=found)


def test_h33():
    wi, alpha = direction(math.acos(0.01)), 0.5
    found = float(models.create("ward:duer:no_diffuse", ks=1.0, alpha=alpha).albedo(wi)[0])
    bounded = float(models.create("ward:bounded:no_diffuse", ks=1.0, alpha=alpha).albedo(wi)[0])
    assert found == pytest.approx(8.7, abs=0.05)
    assert bounded <= 1.0
    shown("H33", naive=found, ours=bounded)


def test_h34():
    values = {"rho": 0.2, "sigma": math.pi / 2}
    wi, wo = grazing(1e-3), grazing(1e-3, math.pi)
    right = exact("oren_nayar:full", wi, wo, **values)
    with np.errstate(all="ignore"):
        naive = np.log(np.float64(right))
    found = ours("oren_nayar:full", wi, wo, **values)
    assert right < 0
    assert np.isnan(naive)
    assert close(found, right, 1e-11)
    for form in ("qualitative", "fujii", "eon"):
        assert ours(f"oren_nayar:{form}", wi, wo, rho=0.2, sigma=1.0) >= 0
    shown("H34", naive=naive, ours=found)


# Draws ------------------------------------------------------------------------------------------------


def test_h35():
    rng = np.random.default_rng(0)
    u = rng.random((20_000, 2))
    ax, ay = 0.1, 0.3
    phi = np.arctan(ay / ax * np.tan(2 * np.pi * u[:, 0]))
    naive = float(np.mean(np.cos(phi) < 0))
    drawn = models.create("ward:anisotropic:no_diffuse", ks=1.0, alpha_x=ax, alpha_y=ay, psi=0.0)
    wo = drawn.sample(NORMAL, 20_000, seed=1).wo
    found = float(np.mean(wo[:, 0] < 0))
    assert naive == 0.0
    assert found == pytest.approx(0.5, abs=0.02)
    assert round(found, 1) == 0.5
    shown("H35", naive=naive, ours=round(found, 1))


def test_h36():
    u = np.array([[0.0, 0.0], [1 - 2.0**-24, 0.25]], np.float32)
    with np.errstate(all="ignore"):
        tan = np.float32(0.3) * np.sqrt(-np.log(u[:, 0]))
        z = 1 / np.sqrt(1 + tan * tan)
        naive = (tan * np.cos(u[:, 1]) * z)[0]
    for kind in (ndf.Beckmann, ndf.GGX):
        h = np.asarray(kind(Isotropic(jnp.asarray(0.3, jnp.float32))).sample(jnp.asarray(u)))
        np.testing.assert_allclose(np.linalg.norm(h, axis=1), 1.0, atol=1e-6)
        assert (h[:, 2] > 0).all()
    assert np.isnan(naive)
    shown("H36", naive=naive, ours=float(h[0, 2]))


def test_h37():
    lobe = PhongLobe(jnp.asarray(-1.0), jnp.asarray(-1.0), jnp.asarray(0.0), jnp.asarray(20.0))
    axis = NORMAL * [-1, -1, 0]
    with np.errstate(all="ignore"):
        naive = (axis / np.linalg.norm(axis))[2]
    found = np.asarray(lobe.sample(jnp.asarray(NORMAL), jnp.full((4, 3), 0.3)))
    assert np.isnan(naive)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=1e-12)
    model = models.create("lafortune:no_diffuse", ks=1.0, n=20.0, gamma=math.pi / 2)
    samples = model.sample(NORMAL, 1000, seed=1)
    assert np.isfinite(samples.weight).all()
    shown("H37", naive=naive, ours=float(np.linalg.norm(found[0])))


def test_h38():
    n = np.float32(1e6)
    u = np.random.default_rng(0).random(100_000, dtype=np.float32)
    c = u ** (1 / (n + np.float32(1)))
    naive = len(np.unique(c))
    lobe = PhongLobe(*(jnp.asarray(v, jnp.float32) for v in (-1.0, -1.0, 1.0, 1e6)))
    drawn = lobe.sample(jnp.asarray(NORMAL, jnp.float32), jnp.stack([u, 0 * u, u], axis=1))
    found = len(np.unique(np.asarray(drawn)[:, 0]))
    assert naive < 400
    assert found > 50_000
    shown("H38", naive=naive, ours=float(f"{found:.1g}"))


def test_h39():
    model = models.create("ward:bounded:no_diffuse", ks=1.0, alpha=0.5)
    wi = direction(1.2)
    wo = direction(math.pi - 1.0, 2.5)
    h = wi + wo
    h = h / np.linalg.norm(h)
    c = abs(h[2])
    tan2 = 1 / c**2 - 1
    naive = math.exp(-tan2 / 0.25) / (math.pi * 0.25 * c**3) / (4 * abs(h @ wi))
    found = float(model.pdf(wi, wo))
    assert wi[2] + wo[2] < 0
    assert naive > 0
    assert found == 0.0
    shown("H39", naive=naive, ours=found)


def test_h40():
    shares = [jnp.asarray(0.3), jnp.asarray(0.3), jnp.asarray(0.3)]  # as if rounding had lost the rest
    lobe = models.create("lambert").mixture(*jnp.asarray(NORMAL))[0][0]
    ends = np.cumsum([0.3, 0.3, 0.3])
    v = np.random.default_rng(0).random(20_000)
    naive = float(np.mean(np.searchsorted(ends, v, side="right") > 2))
    wo, pick = sample_mixture([lobe] * 3, shares, (), jnp.asarray(NORMAL), 20_000, jax.random.key(0))
    found = float(np.mean(np.asarray(pick) > 2))
    assert round(naive, 1) == 0.1
    assert found == 0.0
    np.testing.assert_allclose(np.linalg.norm(wo, axis=1), 1.0, rtol=1e-12)
    shown("H40", naive=round(naive, 1), ours=found)


def test_h41():
    stretched = np.array([0.3 * NORMAL[0], 0.3 * NORMAL[1], NORMAL[2]])
    with np.errstate(all="ignore"):
        tangent = np.cross(NORMAL, stretched)
        naive = (tangent / np.linalg.norm(tangent))[0]
    model = models.create("torrance_sparrow:ggx:smith:none:no_diffuse", ks=1.0, alpha=0.3)
    for dtype in (np.float32, np.float64):
        samples = model.sample(NORMAL.astype(dtype), 4096, seed=1)
        np.testing.assert_allclose(np.linalg.norm(samples.wo, axis=1), 1.0, atol=1e-5)
    assert np.isnan(naive)
    shown("H41", naive=naive, ours=float(np.linalg.norm(samples.wo[0])))


def test_h42():
    model = models.create("specular:dielectric", ks=1.0, eta=1.5)
    wi = direction(0.5)
    samples = model.sample(wi, 10, seed=1)
    with np.errstate(all="ignore"):
        naive = float(np.float64(1.0) / np.float64(0.0))  # a delta as a very narrow lobe: its density
    assert float(model.evaluate(wi, samples.wo[0])[0]) == 0.0
    assert samples.is_delta.all()
    assert not samples.pdf.any()
    np.testing.assert_allclose(samples.wo, np.broadcast_to(wi * [-1, -1, 1], (10, 3)))
    right = float(fresnel.dielectric(jnp.asarray(wi[2]), jnp.asarray(1.5)))
    np.testing.assert_allclose(samples.weight, right, rtol=1e-14)
    shown("H42", naive=naive, ours=float(samples.weight[0, 0]))


# Composed models --------------------------------------------------------------------------------------


def test_h43():
    with np.errstate(all="ignore"):
        a2 = np.float64(0.0) ** 2
        naive = a2 / (np.pi * (1.0 * (a2 - 1) + 1) ** 2)
    model = models.create("metallic_roughness", base_color=0.8, metallic=1.0, roughness=0.0)
    found = float(model.evaluate(NORMAL, NORMAL)[0])
    assert np.isnan(naive)
    assert np.isfinite(found)
    shown("H43", naive=naive, ours=found)


def test_h44():
    wi = direction(0.5)
    with np.errstate(all="ignore"):
        h = -(1.0 * wi + 1.0 * -wi)
        naive = (h / np.linalg.norm(h))[2]
    with pytest.raises(SpecError, match="within") as caught:
        models.create("rough_dielectric", eta=1.0, alpha=0.3)
    assert caught.value.parameter == "eta"
    values = {"ks": 1.0, "kt": 1.0, "eta": 1.01, "alpha": 0.3}
    found = ours("rough_dielectric", wi, -wi, **values)
    assert np.isnan(naive)
    assert close(found, exact("rough_dielectric", wi, -wi, **values), 1e-9)
    assert np.isfinite(gradients("rough_dielectric", wi, -wi, **values)).all()
    shown("H44", naive=naive, ours=found)


def test_h45():
    wi, wo = stored(grazing(1e-6, 0.4), grazing(1e-6, 0.4 - math.pi))
    alpha = np.float32(1e-4)

    @slope_of
    def naive_slope(z):
        hx, hy, hz = wi[0] + wo[0], wi[1] + wo[1], z + wo[2]
        t2 = (hx * hx + hy * hy) / (alpha * hz) ** 2
        return jnp.exp(-t2) * (hx * hx + hy * hy + hz * hz) / (math.pi * alpha * alpha * hz**4)

    with np.errstate(all="ignore"):
        naive = float(naive_slope(jnp.asarray(wi[2])))
    model = models.create("ward:bounded:no_diffuse", ks=1.0, alpha=1e-4)
    model = jax.tree.map(lambda leaf: leaf.astype(np.float32), model)

    @slope_of
    def slope(z):
        return model.evaluate(jnp.asarray(wi).at[2].set(z), wo)[0]

    found = float(slope(jnp.asarray(wi[2])))
    mu, h = mpf(float(wi[2])), mpf("1e-13")

    def lobe(z):
        hx, hy, hz = (mpf(float(a)) + mpf(float(b)) for a, b in zip(wi, wo, strict=True))
        hz = z + mpf(float(wo[2]))
        t2 = (hx * hx + hy * hy) / (mpf(float(alpha)) * hz) ** 2
        return mp.exp(-t2) * (hx**2 + hy**2 + hz**2) / (mp.pi * mpf(float(alpha)) ** 2 * hz**4)

    with mp.workdps(DIGITS):
        right = float((lobe(mu + h) - lobe(mu - h)) / (2 * h))
    assert not np.isfinite(naive)
    assert close(found, right, 1e-4)
    shown("H45", naive=naive, ours=found)


# The page ---------------------------------------------------------------------------------------------


def test_every_row_has_its_test_and_every_test_its_row():
    page = rows()
    assert len(page) >= 25
    assert list(page) == sorted(page, key=lambda case: int(case[1:])), "ids in order, each once"
    here = {
        name for name, f in globals().items() if re.fullmatch(r"test_h\d+", name) and inspect.isfunction(f)
    }
    assert len(ROW.findall(PAGE.read_text())) == len(page)
    named = set()
    for case, cells in page.items():
        found = re.fullmatch(r"`([\w/]+)\.py::(\w+)`", cells[-1])
        assert found, f"{case} names no test: {cells[-1]!r}"
        module = importlib.import_module(f"tests.{found[1].replace('/', '.')}")
        assert inspect.isfunction(getattr(module, found[2], None)), f"{case}: {cells[-1]} does not exist"
        if module.__name__ == __name__:
            assert found[2] == f"test_{case.lower()}"
            named.add(found[2])
    assert named == here
