"""Starting the numerics: JAX with its compiled programs kept between runs of the command."""

from __future__ import annotations

from fitter.cli.screen import Screen


def start_numerics(screen: Screen) -> None:
    """Import JAX and use the compilation cache; says so where the cache can't be written."""
    from fitter._jax import compile_sooner, default_cache_folder, use_compilation_cache

    compile_sooner()
    try:
        use_compilation_cache(default_cache_folder())
    except OSError as error:
        screen.note(f"compiled programs are not kept: {error.filename} can't be made ({error.strerror})")
