"""posterior: independent ensembles run until they agree, or until the budget ends, and which it was."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import progress
from fitter.compression import CompressedTable
from fitter.errors import SpecError
from fitter.fitting.layout import channel_groups, layout
from fitter.fitting.result import FitResult
from fitter.fitting.usable import usable
from fitter.posterior import jackknife
from fitter.posterior.beside import naive
from fitter.posterior.checkpoint import Checkpoint, digest
from fitter.posterior.ensembles import NOWHERE, start
from fitter.posterior.looks import FIRST, look_at
from fitter.posterior.offsets import ANGLES
from fitter.posterior.result import Posterior
from fitter.posterior.writeup import write_up
from fitter.spec import NoiseModel, PosteriorSpec, posterior_spec
from fitter.table import Table

FloatArray = NDArray[np.float64]
#: Steps of a segment; of large tables segments are shorter, so that all walkers together go through about
#: this many values in one, at least a tenth of the steps.
SEGMENT, SEGMENT_VALUES = 50, 400_000_000


def sample(
    table: Table | CompressedTable,
    fit: FitResult,
    spec: PosteriorSpec | None = None,
    *,
    checkpoint: Path | str | None = None,
    robust: bool = True,
    within: Mapping[str, tuple[float, float]] = NOWHERE,
    progress: progress.Progress = progress.ignore,
    **settings: Any,
) -> Posterior:
    """Sample the posterior of a fit's free parameters with emcee.

    Parameters
    ----------
    table, fit : the table and a fit of it (the metric of the fit plays no part: the likelihood does).
    spec, settings : a PosteriorSpec, or its fields as keywords.
    checkpoint : a folder to keep the run in as it goes on. Where it holds the same run already, that one goes
        on and its draws are those of a run that was never stopped; the seconds that it took count. Nothing
        but the budget looks at the clock. The folder stays: delete it when the result is safe.
    robust : False leaves out the robust uncertainty beside the posterior's own, which takes a moment; draws
        that are rescaled to it have it all the same.
    within : narrower ranges than the prior's of linear and noise parameters, by label and in their own units;
        those of the others are bounds of the fit.
    progress : called with (share, text); may raise to stop.

    Returns
    -------
    Posterior : its ``status`` says whether its numbers mean what they say; "not_converged" and the missed
        target where the budget ended first.

    Raises
    ------
    SpecError : settings that make no sense, noise="table" without sigma, or a checkpoint of another run.
    FitError : fewer values than parameters, a likelihood that is nowhere finite, or noise to be inferred from
        residuals that are all rounding.
    """
    begun = time.perf_counter()
    if spec is not None and settings:
        raise SpecError("give a PosteriorSpec or its fields, not both", code="bad-spec", parameter="spec")
    request = spec or posterior_spec(settings)
    if isinstance(table, CompressedTable):
        table = table.decompress()
    kind = noise_of(table, request.noise)
    fit.columns_of(table)
    anisotropic = not fit.model.isotropic(fit.spec.model)
    data = usable(table, "absolute", fit.spec.select, anisotropic=anisotropic)
    places = layout(fit.spec, len(data.channels))
    rng = np.random.default_rng(request.seed)
    index = np.arange(len(data))
    if len(index) > request.max_samples:
        index = np.sort(rng.choice(len(data), request.max_samples, replace=False))
    angles = _angles(table, request)
    groups = channel_groups(fit.spec, len(data.channels))
    if len(angles):
        # Offsets are the instrument's: channels that share nothing else share them.
        if len(groups) > 1:
            places = replace(places, own=(True,) * len(places.free), channels=len(groups))
        groups = [list(range(len(data.channels)))]
    kept = None if checkpoint is None else Checkpoint(Path(checkpoint), digest(table, fit, request, within))
    if kept is not None:
        kept.begin()
    progress(0.0, "finding the mode")
    runs = [start(places, fit, data, index, group, kind, request, angles, rng, within) for group in groups]
    own = {p.name for p in places.linear} | {"relative_noise", "noise_floor"}
    known = {label for run in runs for label in run.labels if label.partition("[")[0] in own}
    if not known.issuperset(within):
        raise SpecError(
            f"{sorted(set(within) - known)[0]!r} is no linear or noise parameter here", code="bad-ranges",
            parameter="within", remedy=f"use {', '.join(sorted(known))}, and bounds of the fit for others",
        )  # fmt: skip
    plain = None
    if len(angles) or request.likelihood != "gaussian":
        plainly = request.model_copy(update={"likelihood": "gaussian"})
        plain = naive(
            [
                start(layout(fit.spec, len(data.channels)), fit, data, index, group, kind, plainly,
                      np.zeros(0), np.random.default_rng(0))
                for group in channel_groups(fit.spec, len(data.channels))
            ]
        )  # fmt: skip
    without_scans = None
    if robust or request.draws == "robust":
        progress(0.0, "leaving out scans")
        without_scans = jackknife.robust(table, fit)
    prepared = time.perf_counter()

    spent = None if kept is None else kept.restore(runs)
    if spent is None:
        spent = 0.0
        for run in runs:
            progress(0.01, "tuning the proposals")
            run.tune()
        if kept is not None:
            kept.tuned(runs, time.perf_counter() - begun)
    tuned = time.perf_counter()

    values = len(index) * sum(len(group) for group in groups) * len(runs[0].proposal.walkers)
    segment = int(np.clip(SEGMENT_VALUES // max(1, values), SEGMENT // 10, SEGMENT))
    history: list[dict[str, float]] = []
    wanted, resumed = FIRST, runs[0].steps
    while True:
        while runs[0].steps < wanted:
            seconds = spent + time.perf_counter() - begun
            if seconds > request.budget_seconds and runs[0].steps:
                break
            progress(min(0.99, seconds / request.budget_seconds), f"sampling: {runs[0].steps} steps")
            for run in runs:
                run.advance(segment)
            if kept is not None:
                kept.extend(runs, spent + time.perf_counter() - begun)
        look = look_at(runs, request, min(wanted, runs[0].steps))
        seconds = spent + time.perf_counter() - begun
        history.append(
            {"steps": float(look.steps), "rhat": look.rhat, "ess": look.ess, "seconds": seconds}
        )
        if look.met or (seconds > request.budget_seconds and runs[0].steps <= wanted):
            break
        wanted = look.next(request, segment)
    progress(1.0, "done")
    phases = {
        "mode": prepared - begun, "tuning": tuned - prepared, "sampling": time.perf_counter() - tuned,
    }  # fmt: skip
    if spent:
        phases["before"] = spent
    return write_up(
        table, fit, request, runs, look, history, kind, data, len(index), phases, resumed, plain,
        without_scans,
    )  # fmt: skip


def noise_of(table: Table, asked: NoiseModel | None) -> NoiseModel:
    """The noise asked for, or else the table's sigma where it has one. Raises SpecError where it has none."""
    kind = asked or ("table" if table.sigma is not None else "inferred")
    if kind == "table" and table.sigma is None:
        raise SpecError(
            "noise 'table' needs the table's own standard uncertainty, and it states none",
            code="noise-needs-sigma", parameter="noise", remedy="use noise='inferred'",
        )  # fmt: skip
    return kind


def _angles(table: Table, request: PosteriorSpec) -> FloatArray:
    """(2 or 3,) standard uncertainties of the instrument's angles in radians; none, no offsets."""
    given, stated = request.angle_uncertainty_deg, table.metadata.angle_uncertainty
    if given is None and request.angles == "exact":
        return np.zeros(0)
    if given is None and not stated:
        raise SpecError(
            "offsets of the angles need their standard uncertainty, and the table states none",
            code="angles-need-uncertainty", parameter="angles", remedy="give angle_uncertainty_deg",
        )  # fmt: skip
    width = float(stated or 0.0) if given is None else float(np.deg2rad(given))
    return np.full(len(ANGLES) - table.domain.in_plane if width > 0 else 0, width)
