"""Starting the numerics: JAX with its compiled programs kept between runs of the command."""

from __future__ import annotations

from fitter.cli.screen import Screen


def start_numerics(screen: Screen) -> None:
    """Import JAX and use the compilation cache; says so where the cache can't be written."""
    from fitter import _jax

    _jax.start(screen.note)
