"""Lafortune's lobes against their own formula: published per-channel fits, anisotropy, extreme exponents."""

from __future__ import annotations

import csv
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitter import datasets, models
from tests.models.statistics import finite, hemisphere

WI, WO = hemisphere(0, 300), hemisphere(1, 300)


def test_published_materials_are_one_model_each():
    """Three lobes of three channels, coefficients and exponents of their own, in one evaluation."""
    with datasets.constants("lafortune_cornell").open() as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    materials = sorted({row["material"] for row in rows})
    assert len(materials) >= 6
    plane, normal = (WI * WO)[:, :2].sum(axis=1), WI[:, 2] * WO[:, 2]
    for material in materials:
        values: dict[str, list[float]] = {"kd": []}
        expected = np.zeros((len(WI), 3))
        for c, channel in enumerate("RGB"):
            own = [r for r in rows if r["material"] == material and r["channel"] == channel]
            assert len(own) == 3
            values["kd"].append(float(own[0]["kd"]))
            expected[:, c] = float(own[0]["kd"]) / np.pi
            for k, row in enumerate(own, start=1):
                cxy, cz, n = (float(row[key]) for key in ("cxy", "cz", "n"))
                expected[:, c] += np.maximum(cxy * plane + cz * normal, 0.0) ** n
                scale = 2 * np.pi * max(abs(cxy), abs(cz)) ** n / (n + 2)
                for name, value in (("ks", scale), ("gamma", math.atan2(-cxy, cz)), ("n", n)):
                    values.setdefault(f"{name}_{k}", []).append(value)
        model = models.create("lafortune:3", **values)
        np.testing.assert_allclose(np.asarray(model.evaluate(WI, WO)), expected, rtol=1e-9)


def test_anisotropic_lobe_is_its_formula_in_the_turned_frame():
    gamma, delta, n, psi = -0.6, 1.1, 7.0, 0.4
    turn = np.array([[np.cos(psi), np.sin(psi), 0], [-np.sin(psi), np.cos(psi), 0], [0, 0, 1]])
    c = np.array(
        [
            -np.sqrt(2) * np.sin(gamma) * np.cos(delta),
            -np.sqrt(2) * np.sin(gamma) * np.sin(delta),
            np.cos(gamma),
        ]
    )
    base = ((WI @ turn.T) * c * (WO @ turn.T)).sum(axis=1) / np.abs(c).max()
    model = models.create("lafortune:anisotropic:no_diffuse", ks=1.0, gamma=gamma, delta=delta, n=n, psi=psi)
    np.testing.assert_allclose(
        np.asarray(model.evaluate(WI, WO))[:, 0], (n + 2) / (2 * np.pi) * np.maximum(base, 0) ** n, rtol=1e-12
    )


@pytest.mark.parametrize("gamma", [-3.0, -1.0, 0.3, math.pi / 4, 2.0])
def test_delta_of_45_degrees_is_isotropic(gamma: float):
    values = {"ks": 0.7, "kd": 0.2, "gamma": gamma, "n": 12.0}
    turned = models.create("lafortune:anisotropic", delta=math.pi / 4, psi=1.0, **values)
    plain = models.create("lafortune", **values)
    np.testing.assert_allclose(
        np.asarray(turned.evaluate(WI, WO)), np.asarray(plain.evaluate(WI, WO)), rtol=1e-12
    )


@pytest.mark.long
@pytest.mark.parametrize("name", ["lafortune:no_diffuse", "lafortune:anisotropic:no_diffuse"])
def test_albedo_is_at_most_ks(name: str):
    for n in (0.0, 0.5, 3.0, 200.0):
        for gamma in (math.pi / 4, -math.pi / 4, 0.2, 1.3, 2.0):
            model = models.create(name, ks=1.0, n=n, gamma=gamma)
            for theta in (0.0, 0.7, 1.5):
                found = float(model.albedo([math.sin(theta), 0.0, math.cos(theta)])[0])
                assert found <= 1 + 1e-6
                if theta == 0 and abs(math.tan(gamma)) <= 1 and math.cos(gamma) > 0:
                    assert found == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("n", [0.0, 0.3, 1.0, 1e6])
@pytest.mark.parametrize("gamma", [math.pi / 4, -math.pi / 4, math.pi / 2, 0.0, math.pi])
def test_slopes_are_finite_whatever_the_base(n: float, gamma: float, dtype: type):
    """Bases of 1, below 0, exactly 0 and next to 0."""
    model = models.create("lafortune:no_diffuse", ks=1.0, gamma=gamma, n=n)
    model = jax.tree.map(lambda leaf: leaf.astype(dtype), model)
    wi = jnp.asarray([0.6, 0.0, 0.8], dtype)
    for wo in (
        [-0.6, 0.0, 0.8],
        [0.6, 0.0, 0.8],
        [0.8, 0.0, 0.6],
        [0.8, 1e-9, 0.6],
        [1.0, 0.0, 1e-30],
        [0, 0, 1],
    ):
        total = lambda args: jnp.sum(args[0].evaluate(args[1], args[2]))  # noqa: E731
        value, slopes = jax.value_and_grad(total)((model, wi, jnp.asarray(wo, dtype)))
        assert finite((value, slopes))
    if n == 0 and gamma == math.pi / 4:
        # Constant where the base is positive, 0 where it is not.
        up, away = jnp.asarray([0.0, 0.0, 1.0], dtype), jnp.asarray([0.99, 0.0, 0.141], dtype)
        assert float(model.evaluate(wi, up)[0]) == pytest.approx(1 / math.pi, rel=1e-6)
        assert float(model.evaluate(away, away)[0]) == 0.0


def test_a_width_of_a_milliradian_keeps_its_digits():
    """n = 1e6 one width off the mirror: exp(-1/2) but for the next order, 3/(8 n)."""
    n, theta, off = 1e6, 0.5, 1e-3
    model = models.create("lafortune:no_diffuse", ks=1.0, gamma=math.pi / 4, n=n)
    wi = np.array([math.sin(theta), 0.0, math.cos(theta)])
    wo = np.array([-math.sin(theta + off), 0.0, math.cos(theta + off)])
    expected = (n + 2) / (2 * math.pi) * math.exp(n * math.log(math.cos(off)))
    assert float(model.evaluate(wi, wo)[0]) == pytest.approx(expected, rel=2e-9)
