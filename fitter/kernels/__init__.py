"""Loops compiled to machine code by Numba: what array operations can't do without a pass over memory each.

A kernel is arrays in, arrays out, and holds no lock: threads run it side by side. It is compiled when it is
first called, which takes three to forty seconds, and kept in the cache folder of the program for the
processes to come; where that can't be written, each process compiles for itself. Numba itself takes a quarter
of a second to import, so the modules of this package are imported where they are needed and not before.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

_numba = cast("Any", numba)
_ONE_AT_A_TIME = Lock()


def compiled(function: Function) -> Function:
    """A kernel: called from Python, without the interpreter's lock; division by 0 is that of IEEE 754."""
    with _ONE_AT_A_TIME:
        # Numba asks for the folder as it decorates, and only then; a host's own use of Numba keeps its own.
        before = _numba.config.CACHE_DIR
        try:
            _numba.config.CACHE_DIR = before or str(cache_folder())
            return _numba.njit(function, nogil=True, cache=True, error_model="numpy")
        except RuntimeError:  # no folder can be written
            return _numba.njit(function, nogil=True, error_model="numpy")
        finally:
            _numba.config.CACHE_DIR = before


def part(function: Function) -> Function:
    """What kernels are made of: compiled into each of them."""
    return _numba.njit(function, error_model="numpy", forceinline=True)


def routine(function: Function) -> Function:
    """A part that is compiled once and called: for those whose copies would take longer to compile than the
    calls ever will."""
    return _numba.njit(function, error_model="numpy")


@cache
def cache_folder() -> Path:
    """Where compiled kernels are kept: one folder for each state of this package, because Numba looks for
    changes in a kernel's own file only, not in the parts that are compiled into it."""
    base = os.environ.get("XDG_CACHE_HOME")
    sources = sha256(b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))))
    folder = (Path(base) if base else Path.home() / ".cache") / "brdf-fitter" / "kernels"
    return folder / sources.hexdigest()[:16]
