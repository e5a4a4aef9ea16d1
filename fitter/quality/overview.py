"""overview: noise and blind spots of a table, for a first look that costs less than the whole check."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fitter.quality import noise, regions
from fitter.quality.checks import SEED
from fitter.quality.hemispheres import hemispheres
from fitter.quality.measured import Measured
from fitter.table import Table


def overview(table: Table, *, seed: int = SEED) -> Mapping[str, Any]:
    """JSON-ready: ``noise`` and ``blind_spots``, each with numbers and sentences.

    noise : ``relative_sd`` of one sample and ``floor_sd_per_sr`` near zero (k = 1, None where not known);
        ``basis`` says whether repeated geometries gave it or neighbours, which only bound it.
    blind_spots : what no *usable* sample covers within the measured region: ``share`` of it, cosine-weighted
        and averaged over the incidences looked at (None where the samples cover no area), the ``largest``
        hole, and how many incidences are ``blind_to_retro`` and ``blind_to_mirror`` of ``incidences``.
    """
    with np.errstate(over="ignore", under="ignore"):
        whole = Measured.of(table, seed)
        usable = Measured.of(table, seed, usable=True)
        return {"noise": _noise(whole), "blind_spots": _blind_spots(usable)}


def _noise(measured: Measured) -> dict[str, Any]:
    repeated, neighbours = noise.scatter(measured), noise.smoothness(measured)
    found = noise.estimate(repeated, neighbours)
    known = repeated is not None and repeated.enough
    finding = noise.repeatability(repeated) if known else noise.smooth(neighbours)
    return {
        "relative_sd": None if found is None else found.relative,
        "floor_sd_per_sr": None if found is None else found.floor,
        "basis": None if found is None else "repeated geometries" if known else "neighbours (upper bound)",
        "sentence": finding.sentence,
    }


def _blind_spots(usable: Measured) -> dict[str, Any]:
    peaks, holes = regions.blind_spots(usable), regions.holes(hemispheres(usable))
    seen, areas = peaks.to_dict()["numbers"], holes.to_dict()["numbers"]
    return {
        "share": areas.get("blind_share"),
        "largest": areas.get("largest"),
        "incidences": len(seen.get("incidences", [])),
        "blind_to_retro": seen.get("blind_to_retro"),
        "blind_to_mirror": seen.get("blind_to_mirror"),
        "sentences": [holes.sentence, peaks.sentence],
    }
