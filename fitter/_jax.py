"""JAX as the numerics need it: 64-bit types, and compiled programs kept between processes."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import jax

from fitter.errors import FitError


def enable_x64() -> None:
    """Turn on float64 in JAX. Raises FitError where the host program forbids it.

    Fits and posteriors are meaningless in float32 (an optimiser stops at chi2/dof 1000 and reports
    success), so there is no fallback.
    """
    if os.environ.get("JAX_ENABLE_X64", "").lower() in ("0", "false", "off"):
        raise FitError(
            "JAX's 64-bit mode is switched off by JAX_ENABLE_X64, and the fitter needs it",
            code="x64-forbidden", remedy="unset JAX_ENABLE_X64 or set it to 1",
        )  # fmt: skip
    jax.config.update("jax_enable_x64", True)


def use_compilation_cache(folder: Path) -> None:
    """Keep compiled programs in ``folder`` between processes (half a second a model saved).

    Where the environment names another one (JAX_COMPILATION_CACHE_DIR), that one stands: servers and commands
    of one user then share what they have compiled. Raises OSError, whose ``filename`` is what can't be made.
    """
    folder = Path(os.environ.get("JAX_COMPILATION_CACHE_DIR") or folder)
    folder.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


#: XLA's newer way of emitting fusions takes twice as long to compile.
_EMITTERS = "xla_cpu_use_fusion_emitters"


def compile_sooner() -> None:
    """Have XLA compile in half the time, for programs about as fast: without its newer way of emitting
    fusions.

    For a process of our own, before its first program: XLA reads XLA_FLAGS once, and what they say of this
    already stands. It ends the process at a flag that it doesn't know: only releases that have it get it.
    """
    said = os.environ.get("XLA_FLAGS", "")
    if _is_open():
        os.environ["XLA_FLAGS"] = f"{said} --{_EMITTERS}=false".strip()


def options() -> dict[str, bool] | None:
    """The same for one program, as ``jax.jit`` takes it: in a process that is somebody else's, too. Passes
    over a table take half the time with it."""
    return {_EMITTERS: False} if _is_open() and jax.default_backend() == "cpu" else None


def _is_open() -> bool:
    """Whether this release can be told how to emit fusions, and has not been."""
    return jax.__version_info__[:2] == (0, 10) and _EMITTERS not in os.environ.get("XLA_FLAGS", "")


def start(tell: Callable[[str], None]) -> None:
    """Get a process of our own ready: programs compile sooner and are kept in the usual folder; ``tell`` is
    told where they can't be."""
    compile_sooner()
    try:
        use_compilation_cache(default_cache_folder())
    except OSError as error:
        tell(f"compiled programs are not kept: {error.filename} can't be made ({error.strerror})")


def default_cache_folder() -> Path:
    """``$XDG_CACHE_HOME/brdf-fitter/xla`` or its usual place below the home folder."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "brdf-fitter" / "xla"
