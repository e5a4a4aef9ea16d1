"""Models to export, with values that differ by channel and are no defaults."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from numpy.typing import NDArray

import fitter
from fitter.export import Exported, target
from fitter.models import ReflectanceModel

FloatArray = NDArray[np.float64]

#: Every part of every family's formula is in one of these.
SOURCES = (
    "lambert", "ward", "ward:bounded:anisotropic", "ward:duer:no_diffuse", "lafortune:2",
    "lafortune:anisotropic", "oren_nayar", "oren_nayar:full", "oren_nayar:fujii", "oren_nayar:eon",
    "torrance_sparrow", "torrance_sparrow:ggx:smith:anisotropic", "torrance_sparrow:smith:coupled",
    "torrance_sparrow:gaussian:smith:none", "torrance_sparrow:blinn:smith_separable:dielectric:coupled",
    "torrance_sparrow:rational:conductor:anisotropic", "torrance_sparrow:ggx:schlick_ggx",
    "torrance_sparrow:smith:anisotropic", "torrance_sparrow:ggx:anisotropic:dielectric",
)  # fmt: skip
_VALUES = {
    "kd": [0.1, 0.3, 0.02], "ks": [0.2, 0.05, 0.4], "f0": [0.04, 0.6, 0.2], "rho": [0.2, 0.5, 0.9],
    "alpha": 0.15, "alpha_x": 0.05, "alpha_y": 0.2, "psi": 0.4, "n": 30.0, "s": 0.2, "eta": 1.6, "kappa": 2.0,
    "sigma": 0.35, "gamma": 0.9, "delta": 0.6, "ks_1": [0.2, 0.1, 0.3], "ks_2": [0.05, 0.02, 0.1],
    "n_1": 12.0, "n_2": 80.0, "gamma_1": 0.6, "gamma_2": -0.8,
}  # fmt: skip


def make(name: str) -> ReflectanceModel:
    """The model of that short name with three channels."""
    table = fitter.models.parameter_table(name)
    chosen = {p.name: _VALUES[p.name] for p in table}
    if "conductor" in name:
        chosen |= {"eta": [0.2, 0.4, 1.5], "kappa": [3.0, 2.0, 0.1]}
    return fitter.models.create(name, channels=("R", "G", "B"), **chosen)


#: Of MERL's and MBSDF's files every byte means something else.
SILENT = ("merl", "mbsdf")
#: Units and cosine of what a file holds.
STATES = re.compile(rb"f_r in 1/sr, without the cosine|f_r cos\(theta_o\)|linear (RGB|Rec|factors)")


def held_to_the_contract(told: Exported) -> None:
    """What holds for anything that was written: whole, alone, described, and its notes are sentences."""
    entry = target(told.target)
    assert [path.name for path in told.path.parent.iterdir()] == [told.path.name]
    assert told.path.is_file() == bool(entry.suffix)
    assert told.to_dict()["convention"] == entry.convention
    assert all(note.message.endswith(".") for note in told.notes), told.notes
    json.dumps(told.to_dict())
    if told.target not in SILENT:
        first = told.path if told.path.is_file() else min(told.path.iterdir())
        # Comments are broken into lines.
        assert STATES.search(re.sub(rb"\s(\W\s)?", b" ", first.read_bytes())), told.target


def directions(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """Pairs (count, 3): all over, a third each down to grazing and about the mirror direction."""
    wi, wo = (_hemisphere(rng, count) for _ in range(2))
    near = np.arange(count) % 3 == 0
    mirrored = wi * [-1.0, -1.0, 1.0] + rng.normal(0, 0.1, (count, 3))
    mirrored[:, 2] = np.abs(mirrored[:, 2])
    wo[near] = (mirrored / np.linalg.norm(mirrored, axis=1)[:, None])[near]
    return wi, wo


def _hemisphere(rng: np.random.Generator, count: int) -> FloatArray:
    z = np.where(np.arange(count) % 3 == 1, 10.0 ** rng.uniform(-5, -1, count), rng.uniform(0.01, 1, count))
    phi = rng.uniform(-np.pi, np.pi, count)
    s = np.sqrt((1 - z) * (1 + z))
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)


@pytest.fixture(scope="session")
def pairs() -> tuple[FloatArray, FloatArray]:
    """10^4 pairs as float32 holds them."""
    wi, wo = directions(np.random.default_rng(11), 10_000)
    return wi.astype(np.float32).astype(np.float64), wo.astype(np.float32).astype(np.float64)
