"""Fit reflectance models to measured BRDF tables, with uncertainties.

``load`` a table, ``fit`` a model to it or ``select`` one, sample its ``posterior``, or draw from the raw
table with ``TableSampler``. Everything loads on first use: the command's help needs neither NumPy nor JAX,
and tables and formats import no JAX.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from fitter._version import __version__
from fitter.errors import FitError, FitterError, SpecError, TableError

if TYPE_CHECKING:
    from fitter import models, posterior
    from fitter.calibration import Calibration, calibrate, load_calibration
    from fitter.compression import CompressedTable, compress
    from fitter.fitting import FitResult, fit, load_fit
    from fitter.formats import load, load_all, write
    from fitter.grid import Grid
    from fitter.large import LargeTable, open_large
    from fitter.metadata import Channel, Metadata
    from fitter.posterior import Posterior
    from fitter.quality import Check, check
    from fitter.sampling import Samples, TableSampler
    from fitter.selection import Selection, select
    from fitter.spec import (
        CalibrationSpec,
        FitSpec,
        ModelSpec,
        PosteriorSpec,
        SelectionSpec,
        TradeoffSpec,
    )
    from fitter.table import Table
    from fitter.tradeoffs import Tradeoff, load_tradeoff, tradeoff

__all__ = [
    "Calibration", "CalibrationSpec", "Channel", "Check", "CompressedTable", "FitError", "FitResult",
    "FitSpec", "FitterError", "Grid", "LargeTable", "Metadata", "ModelSpec", "Posterior", "PosteriorSpec",
    "Samples", "Selection", "SelectionSpec", "SpecError", "Table", "TableError", "TableSampler", "Tradeoff",
    "TradeoffSpec", "__version__", "calibrate", "check", "compress", "fit", "load", "load_all",
    "load_calibration", "load_fit", "load_tradeoff", "models", "open_large", "posterior", "select",
    "tradeoff", "write",
]  # fmt: skip

# Where each name lives (NumPy takes an eighth of a second to import, JAX about a second).
_LAZY = {
    "Calibration": "fitter.calibration", "calibrate": "fitter.calibration",
    "load_calibration": "fitter.calibration", "CalibrationSpec": "fitter.spec",
    "CompressedTable": "fitter.compression", "compress": "fitter.compression",
    "FitResult": "fitter.fitting", "fit": "fitter.fitting", "load_fit": "fitter.fitting",
    "load": "fitter.formats", "load_all": "fitter.formats",
    "write": "fitter.formats",
    "Posterior": "fitter.posterior",
    "LargeTable": "fitter.large", "open_large": "fitter.large",
    "Check": "fitter.quality", "check": "fitter.quality",
    "Samples": "fitter.sampling", "TableSampler": "fitter.sampling",
    "Selection": "fitter.selection", "select": "fitter.selection",
    "FitSpec": "fitter.spec", "ModelSpec": "fitter.spec", "PosteriorSpec": "fitter.spec",
    "SelectionSpec": "fitter.spec", "TradeoffSpec": "fitter.spec",
    "Channel": "fitter.metadata", "Grid": "fitter.grid", "Metadata": "fitter.metadata",
    "Table": "fitter.table",
    "Tradeoff": "fitter.tradeoffs", "load_tradeoff": "fitter.tradeoffs", "tradeoff": "fitter.tradeoffs",
}  # fmt: skip

# Rooms that can be reached as attributes; fitter.posterior is itself callable, see there.
_ROOMS = (
    "batch", "calibration", "compression", "datasets", "directions", "export", "fitting", "formats", "models",
    "posterior", "quality", "report", "sampling", "scene", "selection", "spec", "table", "tradeoffs",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f"fitter.{name}")
    if name in _LAZY:
        found = getattr(importlib.import_module(_LAZY[name]), name)
        globals()[name] = found
        return found
    raise AttributeError(f"module 'fitter' has no attribute {name!r}")
