"""Calibration of posteriors: are intervals of this model, on these directions, right as often as they say?"""

from __future__ import annotations

from fitter.calibration.result import Calibration, Row, load_calibration
from fitter.calibration.run import calibrate

__all__ = ["Calibration", "Row", "calibrate", "load_calibration"]
