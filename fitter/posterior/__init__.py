"""Posteriors of fitted parameters: likelihood, ensemble sampling, diagnostics; uncertainties without one.

The room is itself callable: ``fitter.posterior(table, fit)`` is :func:`sample`. The name of the verb and
the name of the room are both fixed, and importing a submodule binds the room's name in the package, so the
only way to keep the verb from being shadowed is to let the module be the verb.
"""

from __future__ import annotations

import sys
import types
from typing import Any

from fitter.posterior.jackknife import Robust, robust
from fitter.posterior.predictive import Predictive, predictive
from fitter.posterior.result import Diagnostic, Posterior, load_posterior
from fitter.posterior.run import sample
from fitter.posterior.sensitivity import offset_sensitivities

__all__ = [
    "Diagnostic", "Posterior", "Predictive", "Robust", "load_posterior", "offset_sensitivities", "predictive",
    "robust", "sample",
]  # fmt: skip


class _CallableRoom(types.ModuleType):
    def __call__(self, *args: Any, **keywords: Any) -> Posterior:
        return sample(*args, **keywords)


sys.modules[__name__].__class__ = _CallableRoom
