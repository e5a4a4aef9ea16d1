"""Reports of fits: a JSON record and one self-contained HTML page drawn from it."""

from __future__ import annotations

from fitter.report.build import build
from fitter.report.report import Report, load_report

__all__ = ["Report", "build", "load_report"]
