"""``python -m fitter``: the ``brdf-fitter`` command."""

from __future__ import annotations

from fitter.cli import entry

if __name__ == "__main__":
    entry()
