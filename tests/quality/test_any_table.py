"""Any valid table is checked without an error, and what is said of it is strict JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fitter.directions import vector_from_spherical
from fitter.documents import dumps
from fitter.grid import Grid
from fitter.metadata import Metadata
from fitter.quality import check
from fitter.table import Table

LEVELS = st.sampled_from([0.0, 1e-300, 1e-12, 0.3, 1.0, 1e12, 1e150, -1e-3])


def leaves(item: Any) -> Iterator[Any]:
    if isinstance(item, dict):
        for part in item.values():
            yield from leaves(part)
    elif isinstance(item, list):
        for part in item:
            yield from leaves(part)
    else:
        yield item


def judge(table: Table) -> None:
    found = check(table).to_dict()
    assert json.loads(dumps(found)) == found
    for leaf in leaves(found):
        assert not isinstance(leaf, float) or math.isfinite(leaf)
    for finding in found["findings"]:
        assert finding["sentence"].endswith(".")
        assert "nan" not in finding["sentence"].replace("finan", "")


@st.composite
def scattered(draw: st.DrawFn) -> dict[str, Any]:
    n = draw(st.integers(1, 120))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    few = draw(st.sampled_from([1, 2, 5, 200]))
    theta_i = rng.choice(rng.uniform(0, 1.57, few), n) * draw(st.sampled_from([0.0, 1.0]))
    phi_i = rng.choice(rng.uniform(-np.pi, np.pi, draw(st.integers(1, 4))), n)
    plane = draw(st.booleans())
    phi_o = phi_i + np.pi * rng.integers(0, 2, n) if plane else rng.uniform(-np.pi, np.pi, n)
    theta_o = rng.choice(rng.uniform(0, np.pi / 2, draw(st.sampled_from([1, 3, 500]))), n)
    channels = draw(st.integers(1, 3))
    value = draw(LEVELS) * rng.uniform(draw(st.sampled_from([0.0, 1.0])), 1.0, (n, channels))
    value[rng.uniform(size=value.shape) < draw(st.sampled_from([0.0, 0.3]))] = draw(LEVELS)
    value[0] = 0.5  # something has to be usable
    sigma = np.abs(value) * 0.1 + 1e-9 if draw(st.booleans()) else None
    return dict(  # noqa: C408
        angles=(theta_i, phi_i, theta_o, phi_o), value=value,
        sigma=sigma, symmetry=draw(st.sampled_from(["isotropic", "anisotropic", None])),
        negatives=draw(st.sampled_from(["mask", "keep"])), duplicates=draw(st.sampled_from(["mask", "keep"])),
        metadata=dict(  # noqa: C408
            quantity=draw(st.sampled_from(["brdf", "ccbrdf", "reflectance_factor"])),
            aperture=draw(st.sampled_from([None, 0.0, 0.01])),
            scale_uncertainty=draw(st.sampled_from([None, 0.05])),
        ),
    )  # fmt: skip


@st.composite
def gridded(draw: st.DrawFn) -> dict[str, Any]:
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))

    def axis(end: float, most: int) -> Any:
        return np.sort(rng.choice(np.linspace(0, end, 40), draw(st.integers(1, most)), replace=False))

    system = draw(st.sampled_from(["half_difference", "spherical_isotropic", "spherical"]))
    right = np.deg2rad(89.0)
    axes, periodic = {
        "half_difference": (
            {"theta_h": axis(right, 6), "theta_d": axis(right, 6), "phi_d": axis(3.1, 6)}, {"phi_d": np.pi}
        ),
        "spherical_isotropic": (
            {"theta_i": axis(right, 5), "theta_o": axis(right, 8), "dphi": axis(np.pi, 8)}, {}
        ),
        "spherical": (
            {
                "theta_i": axis(right, 3), "phi_i": axis(6.1, 4), "theta_o": axis(right, 4),
                "phi_o": axis(6.1, 6),
            },
            {"phi_i": 2 * np.pi, "phi_o": 2 * np.pi},
        ),
    }[system]  # fmt: skip
    size = int(np.prod([len(nodes) for nodes in axes.values()]))
    value = np.abs(draw(LEVELS)) * rng.uniform(0.1, 1.0, (size, draw(st.integers(1, 2))))
    mask = rng.uniform(size=size) < draw(st.sampled_from([0.5, 1.1]))
    closed = periodic if draw(st.booleans()) else {}
    return {"system": system, "axes": axes, "periodic": closed, "value": value, "mask": mask}


@given(scattered())
def test_any_scattered_table(drawn: dict[str, Any]) -> None:
    # Made here: what checks types at run time draws random numbers, which a strategy must not.
    theta_i, phi_i, theta_o, phi_o = drawn.pop("angles")
    wi, wo = vector_from_spherical(theta_i, phi_i), vector_from_spherical(theta_o, phi_o)
    judge(Table(wi=wi, wo=wo, metadata=Metadata(**drawn.pop("metadata")), **drawn))


@pytest.mark.long
@given(gridded())
def test_any_grid(drawn: dict[str, Any]) -> None:
    grid = Grid(drawn["system"], drawn["axes"], drawn["periodic"])
    wi, wo = grid.directions()
    assume((drawn["mask"] & (wi[:, 2] > 1e-9) & (wo[:, 2] > 1e-9)).any())
    judge(Table(value=drawn["value"], grid=grid, mask=drawn["mask"]))
