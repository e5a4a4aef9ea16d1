"""Readers: what the fork server of :mod:`api.parsing` loads, so that no upload waits for it."""

from __future__ import annotations

import importlib

import pyarrow

from api.tables import parse
from fitter.formats.describe import describe
from fitter.formats.registry import formats

__all__ = ["describe", "parse"]

formats()
# Libraries that a format loads when it meets a file of its own.
for _name in ("pyarrow.csv", "pyarrow.parquet", "OpenEXR", "pyfive", "numpy.ma", "encodings.utf_8_sig"):
    importlib.import_module(_name)
# Arrow's own allocator reserves a gigabyte at its first use, which the limit on memory would count.
pyarrow.set_memory_pool(pyarrow.system_memory_pool())
