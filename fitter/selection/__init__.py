"""Choosing a model: candidates fitted, compared on scans that they have not seen, and ranked."""

from __future__ import annotations

from fitter.selection.compare import Difference
from fitter.selection.result import Ranked, RawTable, Selection
from fitter.selection.run import select

__all__ = ["Difference", "Ranked", "RawTable", "Selection", "select"]
