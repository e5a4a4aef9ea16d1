"""What kernels are made of: random numbers against published ones, angles against the libraries', the
cache."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fitter.kernels import angles, cache_folder, compiled, uniform
from fitter.kernels.bilinear import halley, halved, linear, up_to


def test_random_numbers_are_the_published_ones() -> None:
    """xoshiro256++ from the state 1, 2, 3, 4, as its authors' C program gives them, on every lane."""
    state = np.repeat(np.array([1, 2, 3, 4], np.uint64), uniform.LANES)
    first = [
        41943041, 58720359, 3588806011781223, 3591011842654386, 9228616714210784205,
        9973669472204895162, 14011001112246962877, 12406186145184390807, 15849039046786891736,
        10450023813501588000,
    ]  # fmt: skip
    found = np.empty((10, uniform.LANES), np.uint64)
    uniform.words(state, found[:4].reshape(-1))
    uniform.words(state, found[4:].reshape(-1))  # the streams go on where they were
    assert (found == np.array(first, np.uint64)[:, None]).all()


@compiled
def _numbers(bits: np.ndarray, count: int) -> None:
    uniform.two(bits, 0, 2 * count, count)
    uniform.one(bits, count, count)


def test_numbers_of_words() -> None:
    """One number of 52 bits, or one of 38 and one of 26, which share none of a word's bits."""
    words = np.random.default_rng(3).integers(0, 2**64, 1000, np.uint64)
    words[:3] = 0, 2**64 - 1, 2**38 - 1
    bits = np.concatenate([words, words, words])
    _numbers(bits, 1000)
    low, one, high = bits.view(np.float64).reshape(3, 1000) - 1
    assert (one * 2**52 == words >> np.uint64(12)).all()
    assert (high * 2**26 == words >> np.uint64(38)).all()
    assert (low * 2**38 == words % np.uint64(2**38)).all()


@compiled
def _of_angles(angle: np.ndarray, found: np.ndarray) -> None:
    for k in range(len(angle)):
        found[0, k], found[1, k] = angles.cosine_and_sine(angle[k])


@compiled
def _of_points(y: np.ndarray, x: np.ndarray, found: np.ndarray) -> None:
    for k in range(len(x)):
        found[k] = angles.arc(y[k], x[k])


def test_sines_and_cosines() -> None:
    rng = np.random.default_rng(0)
    angle = np.concatenate(
        [rng.uniform(-10, 10, 100_000), rng.uniform(-1e-3, 1e-3, 1000), np.arange(-12, 13) * np.pi / 4, [0.0]]
    )
    found = np.empty((2, len(angle)))
    _of_angles(angle, found)
    np.testing.assert_allclose(found[0], np.cos(angle), rtol=0, atol=3e-16)
    np.testing.assert_allclose(found[1], np.sin(angle), rtol=0, atol=3e-16)
    short = rng.uniform(-0.26, 0.26, 1000)
    np.testing.assert_allclose([angles.short_sine(x) for x in short], np.sin(short), rtol=1e-13)
    np.testing.assert_allclose([angles.short_cosine(x) for x in short], np.cos(short), rtol=1e-13)


def test_arc_tangents() -> None:
    rng = np.random.default_rng(1)
    y, x = rng.normal(size=(2, 100_000))
    y[:1000] *= 1e-9
    x[1000:2000] *= 1e-9
    x[2000], y[2001] = 0.0, 0.0
    found = np.empty(len(x))
    _of_points(y, x, found)
    np.testing.assert_allclose(found, np.arctan2(y, x), rtol=1e-15, atol=0)
    _of_points(np.zeros(1), np.zeros(1), found[:1])
    assert found[0] == 0.0


def test_arcs_are_inverted_to_rounding() -> None:
    """Two of Halley's steps from the start that the kernel takes, or halving, against the integral itself."""
    rng = np.random.default_rng(2)
    for _ in range(300):
        height, theta = rng.uniform(1e-4, 0.13), rng.uniform(0, 1.44)
        a, b = rng.random(2) ** 4
        u = rng.random()
        sine, cosine = np.sin(2 * theta), np.cos(2 * theta)
        flat, slope = up_to(1.0, height, sine, cosine)
        whole = a * flat + (b - a) * slope
        s = linear(u, a * sine, b * np.sin(2 * theta + 2 * height))
        for _ in range(2):
            s, step = halley(s, u * whole, a, b, sine, cosine, height)
        if step > 1e-5 * min(s, 1 - s):
            s = halved(u * whole, a, b, sine, cosine, height)
        flat, slope = up_to(s, height, sine, cosine)
        assert a * flat + (b - a) * slope == pytest.approx(u * whole, rel=1e-12, abs=1e-13 * whole)


def test_kernels_are_kept_and_do_without_a_folder(tmp_path: Path) -> None:
    """In the program's own cache folder; where that can't be made, each process compiles; Numba's own
    setting stays."""
    code = (
        "import numba, numpy as np; from fitter.kernels import uniform; "
        "found = np.empty(16, np.uint64); "
        "uniform.words(np.repeat(np.array([1, 2, 3, 4], np.uint64), 16), found); "
        "print(found[0], repr(numba.config.CACHE_DIR))"
    )
    (tmp_path / "file").write_text("in the way of a folder")
    for base in (tmp_path / "kept", tmp_path / "file"):
        env = {**os.environ, "XDG_CACHE_HOME": str(base)}
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, env=env, check=True
        )
        assert done.stdout.split() == ["41943041", "''"]
    kept = list((tmp_path / "kept" / "brdf-fitter" / "kernels" / cache_folder().name).rglob("*.nbc"))
    assert kept
