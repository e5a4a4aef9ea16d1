"""Starting the numerics: JAX with its compiled programs kept between runs of the command."""

from __future__ import annotations

from fitter.cli.screen import Screen


def start_numerics(screen: Screen) -> None:
    """Import JAX and use the compilation cache; says so where the cache can't be written."""
    from fitter._jax import compile_sooner, default_cache_folder, use_compilation_cache

    compile_sooner()
    folder = default_cache_folder()
    try:
        use_compilation_cache(folder)
    except OSError as error:
        screen.note(f"compiled programs are not kept: {folder} can't be written ({error.strerror})")
