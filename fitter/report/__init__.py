"""Reports of fits: a JSON record and one self-contained HTML page drawn from it; pictures of tables.

Reports load on first use: a table's picture needs no JAX.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fitter.report.build import build, complete
    from fitter.report.report import Report, load_report

__all__ = ["Report", "build", "complete", "load_report"]

_LAZY = {
    "Report": "fitter.report.report", "build": "fitter.report.build", "complete": "fitter.report.build",
    "load_report": "fitter.report.report",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module 'fitter.report' has no attribute {name!r}")
    # All at once: importing the module `build` would leave it under the name of the function.
    for known, module in _LAZY.items():
        globals()[known] = getattr(importlib.import_module(module), known)
    return globals()[name]
