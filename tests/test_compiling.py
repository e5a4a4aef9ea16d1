"""How XLA is asked to compile: what a person has said stands, and only releases that know the flag get it."""

from __future__ import annotations

import os

import jax
import pytest

from fitter._jax import compile_sooner, options

FLAG = "--xla_cpu_use_fusion_emitters=false"


@pytest.mark.parametrize(
    ("said", "release", "expected"),
    [
        (None, (0, 10, 2), FLAG),
        ("--xla_cpu_enable_fast_math=false", (0, 10, 0), f"--xla_cpu_enable_fast_math=false {FLAG}"),
        ("--xla_cpu_use_fusion_emitters=true", (0, 10, 2), "--xla_cpu_use_fusion_emitters=true"),
        (None, (0, 11, 0), None),
    ],
)
def test_flags(
    monkeypatch: pytest.MonkeyPatch, said: str | None, release: tuple[int, ...], expected: str | None
) -> None:
    monkeypatch.setattr(jax, "__version_info__", release)
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    if said is not None:
        monkeypatch.setenv("XLA_FLAGS", said)
    # One program at a time, where the process is somebody else's; not once the whole process has it.
    assert options() == ({"xla_cpu_use_fusion_emitters": False} if expected != said else None)
    compile_sooner()
    assert os.environ.get("XLA_FLAGS") == expected
    assert options() is None
