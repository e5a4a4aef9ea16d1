"""Programs kept between processes: made once, found again, never a wrong one."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitter import programs
from fitter._jax import enable_x64

enable_x64()


@dataclass(frozen=True)
class Scale:
    """A static argument."""

    by: float


class Program:
    """A kept function that counts how often it is traced."""

    def __init__(self) -> None:
        self.traced = 0

        def scaled(scale: Any, x: jax.Array, pair: tuple[jax.Array, jax.Array]) -> Any:
            self.traced += 1
            factor = scale.by if isinstance(scale, Scale) else 1.0
            return factor * x, jnp.linalg.lstsq(pair[0], pair[1])[0]

        self.call = programs.kept("scale")(scaled)

    def __call__(self, scale: object, x: Any = 2.0) -> float:
        pair = np.array([[1.0], [1.0]]), np.array([1.0, 3.0])
        found, slope = self.call(scale, x, pair)
        assert float(slope[0]) == pytest.approx(2.0)
        return float(jnp.sum(found))


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A folder of its own for the programs of a test, none of them in memory."""
    before = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    programs._program.cache_clear()  # pyright: ignore[reportPrivateUsage]
    yield tmp_path
    jax.config.update("jax_compilation_cache_dir", before)


def _forget() -> None:
    programs._program.cache_clear()  # pyright: ignore[reportPrivateUsage]


def _files(folder: Path) -> list[Path]:
    return sorted(folder.glob("program-*"))


def test_traced_once_and_found_again(folder: Path):
    first = Program()
    assert [first(Scale(3.0)), first(Scale(3.0))] == [6.0, 6.0]
    assert first.traced == 1
    _forget()
    second = Program()
    assert second(Scale(3.0)) == 6.0
    assert (second.traced, len(_files(folder))) == (0, 1)


def test_arrays_are_not_kept(folder: Path):
    """Neither traced nor found does a program hold the arrays that it was first asked for with."""
    for traced in (1, 0):
        _forget()
        program = Program()
        x = np.arange(3.0)
        held = weakref.ref(x)
        assert program(Scale(3.0), x) == 9.0
        assert program.traced == traced
        del x, program
        gc.collect()
        assert held() is None


def test_what_differs_is_another_program(folder: Path):
    program = Program()
    assert program(Scale(3.0)) == 6.0
    assert program(Scale(4.0)) == 8.0
    assert program(Scale(3.0), np.arange(3.0)) == 9.0
    assert program(Scale(3.0), np.arange(3, dtype=np.float32)) == 9.0
    assert len(_files(folder)) == 4
    assert program(Scale(by=3.0), x=5.0) == 15.0  # another value is none
    assert len(_files(folder)) == 4


def test_another_source_is_another_program(folder: Path, monkeypatch: pytest.MonkeyPatch):
    Program()(Scale(3.0))
    _forget()
    monkeypatch.setattr(programs, "_surroundings", lambda: ("another release",))
    program = Program()
    assert program(Scale(3.0)) == 6.0
    assert (program.traced, len(_files(folder))) == (1, 2)


@pytest.mark.parametrize("damage", [b"", b"brdf-fitter program 1\n", b"flipped"])
def test_a_damaged_file_is_made_again(folder: Path, damage: bytes):
    Program()(Scale(3.0))
    (file,) = _files(folder)
    whole = file.read_bytes()
    file.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]) if damage == b"flipped" else damage)
    _forget()
    program = Program()
    assert program(Scale(3.0)) == 6.0
    assert program.traced == 1
    _forget()
    assert (Program()(Scale(3.0)), file.read_bytes()[:22]) == (6.0, whole[:22])


def test_what_can_not_be_written_is_not_kept(folder: Path):
    place = folder / "file"
    place.write_bytes(b"in the way")
    jax.config.update("jax_compilation_cache_dir", str(place))
    with pytest.warns((RuntimeWarning, UserWarning), match="not kept|cache"):
        assert Program()(Scale(3.0)) == 6.0


def test_models_of_others_are_not_kept(folder: Path):
    @dataclass(frozen=True)
    class Foreign:
        family: type

    theirs = type("Theirs", (), {"__module__": "theirs"})
    assert Program()(Foreign(theirs)) == 2.0
    assert not _files(folder)


def test_part_of_a_larger_program(folder: Path):
    program = Program()
    doubled = jax.jit(lambda x: 2.0 * program.call(Scale(3.0), x, (jnp.ones((2, 1)), jnp.ones(2)))[0])
    assert float(doubled(1.0)) == 6.0
    assert not _files(folder)


def test_without_a_folder_as_jit_does():
    before = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        assert Program()(Scale(3.0)) == 6.0
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
