"""What bounds of plans are made of: pieces of lamps, cells, Fresnel terms over intervals."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from fitter.models import create, fresnel
from fitter.scene import cells, scene
from fitter.scene.boxes import Boxes
from fitter.scene.cells import Pieces
from fitter.scene.criteria import joint
from fitter.scene.fresnel import reflectance
from fitter.scene.intervals import Interval
from fitter.scene.surfaces import Surfaces
from tests.scene.scenes import document
from tests.scene.test_plan import BALL, BULB, LAMP, PLANE, SKY, SUN


def pieces(shape: tuple[int, int]) -> Pieces:
    cell, piece = (index.reshape(-1) for index in np.indices(shape))
    none = Boxes(cell, cell, np.zeros((len(cell), 4)), np.zeros((len(cell), 4)))
    return Pieces(none, none, cell, piece, np.ones(len(cell)))


@pytest.mark.parametrize("several", [1, 2, 5, 40])
def test_no_choice_of_pieces_exceeds_their_bound(several: int) -> None:
    rng = np.random.default_rng(several)
    shape = 200, several
    l, e = np.exp(rng.normal(-1, 2, shape)), np.exp(rng.normal(-3, 2, shape))
    change = e * l
    # Enclosures are no points: d and e are both more than what there is, or one of them is no bound at all.
    d = change * np.exp(rng.exponential(0.3, shape))
    each = np.where(rng.random(shape) < 0.1, np.inf, e * np.exp(rng.exponential(0.3, shape)))
    sure = rng.random(shape) < 0.4
    least = np.where(sure, l * rng.uniform(0.5, 1, shape), 0.0)
    found = pieces(shape)
    bound = joint(each.reshape(-1), d.reshape(-1), least.reshape(-1), found, shape)
    worst = np.zeros(shape[0])
    for _ in range(2_000):
        x = np.where(sure, 1.0, rng.random(shape) < rng.random((shape[0], 1)))
        worst = np.maximum(worst, (x * change).sum(axis=1) / np.maximum((x * l).sum(axis=1), 1.0))
    assert (worst <= bound * (1 + 1e-12)).all()
    # And where enclosures are points it is hardly more.
    exact = joint(e.reshape(-1), change.reshape(-1), np.where(sure, l, 0.0).reshape(-1), found, shape)
    assert np.median(exact / worst) < 1.1


def test_bounds_of_pieces_without_limits() -> None:
    shape = 3, 2
    each = np.array([[np.inf, 0.0], [np.inf, np.inf], [0.0, 0.0]])
    change = np.array([[0.1, 0.0], [np.inf, 0.1], [0.0, 0.0]])
    bound = joint(each.reshape(-1), change.reshape(-1), np.zeros(6), pieces(shape), shape)
    assert bound[0] == pytest.approx(0.1)
    assert np.isinf(bound[1])
    assert bound[2] == 0


@pytest.mark.parametrize("shape", [PLANE, BALL])
def test_halves_hold_what_their_cells_do(shape: dict[str, Any]) -> None:
    found = scene(document(shapes=[shape], lights=[SUN, BULB, LAMP, SKY], materials={"m": {
        "model": "lambert", "values": {"kd": 0.5}}}))  # fmt: skip
    surfaces, rng = Surfaces(found), np.random.default_rng(3)
    every = cells.start(surfaces, 0)
    for _ in range(6):
        at = every.low + rng.random(every.low.shape) * (every.high - every.low)
        halves = cells.halves(surfaces, every)
        inside = (halves.low <= at[:, None]).all(axis=2) & (at[:, None] <= halves.high).all(axis=2)
        same = halves.primitive == every.primitive[:, None]
        assert (inside & same).any(axis=1).all()
        every = halves
        # The pieces of each lamp are the whole lamp, once.
        parts = cells.pieces(surfaces, every, (0, 1, 2, 3))
        for k in range(4):
            mine = parts.boxes.lamp == k
            assert np.allclose(np.bincount(parts.cell[mine], parts.share[mine], len(every)), 1)
            least, most = np.array(surfaces.extent(k))
            sizes = ((parts.boxes.high - parts.boxes.low)[mine, 2:] / np.where(most > least, most - least, 1))
            area = np.where(most > least, sizes, 1).prod(axis=1)
            assert np.allclose(area, parts.share[mine])
        assert len(np.unique(parts.cell * 10_000 + parts.piece)) == len(parts.cell)
    assert every.level.max() > 0


@pytest.mark.parametrize("kappa", [None, 0.3, 3.0, 7.0])
@pytest.mark.parametrize("eta", [1.1, 1.5, 2.4])
def test_fresnel_terms_are_enclosed_tightly(eta: float, kappa: float | None) -> None:
    kind = "dielectric" if kappa is None else "conductor"
    values = {"eta": eta} if kappa is None else {"eta": eta, "kappa": kappa}
    model = create(f"torrance_sparrow:ggx:{kind}", kd=0.1, ks=1.0, alpha=0.3, **values)
    rng = np.random.default_rng(1)
    low = rng.random(500)
    high = low + (1 - low) * rng.random(500) ** 4
    found = reflectance(model.spec, values, Interval(low, high))
    at = low + np.linspace(0, 1, 501)[:, None] * (high - low)
    exact = np.asarray(fresnel.exact(kind, {k: jnp.asarray(v) for k, v in values.items()}, jnp.asarray(at)))
    assert (found.lo <= exact + 1e-12).all()
    assert (exact <= found.hi + 1e-12).all()
    wide = high - low > 0.01
    assert np.allclose(found.lo[wide], exact.min(axis=0)[wide], atol=5e-3)
    assert np.allclose(found.hi[wide], exact.max(axis=0)[wide], atol=5e-3)
