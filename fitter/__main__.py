"""``python -m fitter``: the ``brdf-fitter`` command."""

from __future__ import annotations

import sys

from fitter.cli import main

if __name__ == "__main__":
    sys.exit(main())
