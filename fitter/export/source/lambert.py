"""Lambert's law: see :mod:`fitter.models.lambert`."""

from __future__ import annotations

from fitter.export.source.formula import Formula, arguments_of
from fitter.models import ReflectanceModel


def formula(model: ReflectanceModel) -> Formula:
    return Formula(model.channels, tuple(arguments_of(model)), (), "kd / PI")
