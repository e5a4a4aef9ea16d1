"""Quality of a measured table: findings with numbers, a verdict and a sentence each. Nothing is fitted."""

from __future__ import annotations

from fitter.quality.checks import KIND, Check, check
from fitter.quality.finding import Finding, Verdict
from fitter.quality.overview import overview

__all__ = ["KIND", "Check", "Finding", "Verdict", "check", "overview"]
