"""Convergence over all walkers of independent ensembles: rank-normalised R-hat, bulk and tail ESS."""

from __future__ import annotations

from typing import Any

import emcee
import numpy as np
from arviz_stats.base.array import array_stats
from numpy.typing import NDArray

from fitter.posterior.result import Diagnostic

FloatArray = NDArray[np.float64]


def diagnose(chains: FloatArray) -> list[Diagnostic]:
    """One Diagnostic per parameter of chains (walkers, steps, P) (Vehtari et al. 2021).

    A pooled R-hat over ensembles hides a walker that is stuck (1.03 where the all-walker value is 1.80),
    so each walker is a chain.
    """
    found: list[Diagnostic] = []
    for k in range(chains.shape[2]):
        x = np.ascontiguousarray(chains[:, :, k])
        if np.ptp(x) == 0:
            found.append(Diagnostic(float("inf"), 0.0, 0.0, float("inf")))
            continue
        bulk: Any = array_stats.ess(x, chain_axis=0, draw_axis=1, method="bulk")
        tail: Any = array_stats.ess(x, chain_axis=0, draw_axis=1, method="tail", prob=(0.05, 0.95))
        rhat: Any = array_stats.rhat(x, chain_axis=0, draw_axis=1, method="rank")
        # The average of the walkers' autocorrelation functions, not that of their mean (emcee issue 209).
        moved = x[np.ptp(x, axis=1) > 0]
        tau = emcee.autocorr.integrated_time(moved.T[:, :, None], tol=0, quiet=True)[0]
        found.append(Diagnostic(float(rhat), float(bulk), float(tail), float(tau)))
    return found
