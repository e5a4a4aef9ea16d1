"""Fitting: metric x solver -> FitResult."""

from __future__ import annotations

from fitter.fitting.engine import check, fit
from fitter.fitting.published import Published, published
from fitter.fitting.result import Estimate, FitResult, load_fit

__all__ = ["Estimate", "FitResult", "Published", "check", "fit", "load_fit", "published"]
