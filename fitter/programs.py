"""Programs kept between processes before they are compiled, so that the second process need not trace them.

JAX's own cache of compiled programs spares their compilation. What is left, tracing and lowering Python code,
takes a process's first fit two seconds. A program marked :func:`kept` is written beside that cache as
``jax.export`` has it (StableHLO), under a name that holds all it depends on; who finds it there reads it in
milliseconds, and JAX finds what it compiles to in its cache.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import warnings
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import jax
from jax import export
from jax.core import Tracer

from fitter._jax import options
from fitter.documents import write_bytes
from fitter.versions import installed

P = ParamSpec("P")
R = TypeVar("R")

#: What a kept program begins with; then the sha256 of the rest, then the rest.
_MAGIC = b"brdf-fitter program 1\n"
#: Releases that make other programs of the same source.
_MAKERS = ("jax", "jaxlib", "equinox", "optimistix", "lineax")
# Calls of LAPACK that JAX does not promise to keep for its later releases. The name holds the release.
_UNCHECKED = [export.DisabledSafetyCheck.custom_call("lapack_dormqr_ffi")]


def kept(*static: str) -> Callable[[Callable[P, R]], Callable[..., R]]:
    """Compile a function as ``jax.jit`` with the ``static`` arguments does, and keep the programs.

    Static arguments must be told apart by their ``repr`` as by their equality. A model of somebody else's
    code (``family`` of such an argument) is not kept: a file can't tell when that code changes.
    """

    def decorate(function: Callable[P, R]) -> Callable[..., R]:
        part = jax.jit(function, static_argnames=static)

        @functools.cache
        def whole() -> Callable[..., R]:
            return jax.jit(function, static_argnames=static, compiler_options=options())

        names = tuple(inspect.signature(function).parameters)
        told = f"{function.__module__}.{function.__qualname__}"

        @functools.wraps(function)
        def call(*args: P.args, **keywords: P.kwargs) -> R:
            given = dict(zip(names, args, strict=False)) | keywords
            ordered = tuple(given[name] for name in names)
            arrays = tuple(given[name] for name in names if name not in static)
            leaves, tree = jax.tree.flatten(arrays)
            # Part of another program, which has options of its own.
            if any(isinstance(leaf, Tracer) for leaf in leaves):
                return part(*args, **keywords)
            folder = _folder(ordered)
            if folder is None:
                return whole()(*args, **keywords)
            shapes = tuple((a.shape, a.dtype, a.weak_type) for a in map(jax.typeof, leaves))

            def make() -> export.Exported:
                return export.export(part, disabled_checks=_UNCHECKED)(*ordered)

            asked = _Asked((tree, shapes), make)
            program = _program(folder, told, tuple((name, given[name]) for name in static), asked)
            return cast("R", program(*arrays))

        return call

    return decorate


class _Asked:
    """What arrays a program is for, and what makes it where it isn't kept. Equal where the arrays are."""

    def __init__(self, arrays: Hashable, make: Callable[[], export.Exported]) -> None:
        self.arrays = arrays
        self.make: Callable[[], export.Exported] | None = make

    def __hash__(self) -> int:
        return hash(self.arrays)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Asked) and self.arrays == other.arrays


def _folder(given: Sequence[object]) -> str | None:
    """Where programs are kept; None where they are not."""
    place: str | None = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if not place or jax.default_backend() != "cpu":
        return None
    families = [family for a in given if isinstance(family := getattr(a, "family", None), type)]
    return place if all(family.__module__.startswith("fitter.") for family in families) else None


@functools.lru_cache(maxsize=512)
def _program(folder: str, told: str, settled: tuple[tuple[str, Hashable], ...], asked: _Asked) -> Any:
    """The program as a function of its arrays: from its file, else traced and written there."""
    name = hashlib.sha256(repr((told, settled, asked.arrays, _surroundings())).encode()).hexdigest()
    path = Path(folder) / f"program-{name[:40]}"
    found = _read(path)
    if found is None:
        assert asked.make is not None
        found = asked.make()
        content = bytes(found.serialize())
        try:
            write_bytes(_MAGIC + hashlib.sha256(content).digest() + content, path)
        except OSError as error:  # the work itself can go on
            warnings.warn(f"a program was not kept: {error}", RuntimeWarning, stacklevel=2)
    # Compiled from what was exported in the first process, too, so that the second one finds just that.
    program = jax.jit(found.call, compiler_options=options())
    # The memory of programs keeps what was asked: not also the arrays of whoever asked first.
    asked.make = None
    return program


def _read(path: Path) -> export.Exported | None:
    """The program in a file; None where there is none, or a damaged one."""
    if not path.exists():
        return None
    data = path.read_bytes()
    head, content = data[: len(_MAGIC) + 32], data[len(_MAGIC) + 32 :]
    whole = head == _MAGIC + hashlib.sha256(content).digest()
    return export.deserialize(bytearray(content)) if whole else None


@functools.cache
def _surroundings() -> tuple[str, ...]:
    """What else a program depends on: our source and that of the libraries that trace it."""
    source = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        source.update(path.read_bytes())
    return source.hexdigest(), *(installed(name) for name in _MAKERS)
