"""Looks at a chain: whether it meets its targets, and when to look again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fitter.posterior.diagnostics import diagnose
from fitter.posterior.ensembles import Ensembles
from fitter.posterior.result import Diagnostic
from fitter.spec import PosteriorSpec

#: Steps before the first look.
FIRST = 100
#: Parts of the chain that are discarded: the first that meets the targets. Walkers start where tuning left
#: them.
DISCARDED = (0.125, 0.5)
#: How much longer a chain becomes from one look to the next. How much it needs is known from how far it is
#: from its targets, which R-hat - 1 nears as 1/steps.
LEAST_GROWTH, MOST_GROWTH, MARGIN = 1.25, 2.0, 1.1


@dataclass(frozen=True)
class Look:
    """What the diagnostics say of the first ``steps``, the first of them discarded."""

    steps: int
    discarded: int
    found: list[list[Diagnostic]]
    rhat: float
    ess: float
    met: bool

    def next(self, request: PosteriorSpec, segment: int) -> int:
        """Steps until the next look, in whole segments."""
        short = max((self.rhat - 1.0) / (request.rhat - 1.0), request.ess / max(self.ess, 1.0))
        growth = float(np.clip(MARGIN * np.nan_to_num(short, nan=np.inf), LEAST_GROWTH, MOST_GROWTH))
        return -(-int(growth * self.steps) // segment) * segment


def look_at(runs: list[Ensembles], request: PosteriorSpec, steps: int) -> Look:
    look: Look | None = None
    for share in DISCARDED:
        discarded = int(share * steps)
        found = [diagnose(run.chains(discarded, steps)) for run in runs]
        every = [d for group in found for d in group]
        rhat = max(d.rhat for d in every)
        ess = min(min(d.ess_bulk, d.ess_tail) for d in every)
        met = rhat < request.rhat and ess >= request.ess
        if look is None or met or rhat < look.rhat:
            look = Look(steps, discarded, found, rhat, ess, met)
        if met:
            break
    assert look is not None
    return look
