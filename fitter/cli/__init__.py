"""The ``brdf-fitter`` command: one file per verb in :mod:`fitter.cli.verbs`."""

from __future__ import annotations

from fitter.cli.app import entry, main

__all__ = ["entry", "main"]
