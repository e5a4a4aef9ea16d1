"""What accuracy costs: error against seconds and memory, measured on one table and one machine."""

from __future__ import annotations

from fitter.tradeoffs.measure import tradeoff
from fitter.tradeoffs.result import Point, Tradeoff, load_tradeoff

__all__ = ["Point", "Tradeoff", "load_tradeoff", "tradeoff"]
