"""The ``brdf-fitter`` command: one file per verb in :mod:`fitter.cli.verbs`."""

from __future__ import annotations

from fitter.cli.app import main

__all__ = ["main"]
