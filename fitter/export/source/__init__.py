"""Evaluation source: one formula a family, printed in Python, C and GLSL."""

from __future__ import annotations

from fitter.export.source.formula import Formula, formula_of

__all__ = ["Formula", "formula_of"]
