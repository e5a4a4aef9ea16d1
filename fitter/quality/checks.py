"""check: everything that can be said of a measured table before anything is fitted to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fitter.large import LargeTable
from fitter.quality import energy, grazing, large, noise, pairs, peaks, regions, values
from fitter.quality.finding import VERDICTS, Finding, Verdict
from fitter.quality.hemispheres import hemispheres
from fitter.quality.measured import AT_NORMAL, Measured
from fitter.table import Table

KIND = "brdf-fitter/check"
SEED = 0


@dataclass(frozen=True)
class Check:
    """The findings of one table.

    samples : that were measured (finite, above the horizon); looked_at : of those, the ones whose directions
    were used, drawn with ``seed`` where the table is a large grid.
    """

    name: str
    hash: str
    samples: int
    looked_at: int
    seed: int
    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> Verdict:
        """The most serious one."""
        return VERDICTS[max(VERDICTS.index(finding.verdict) for finding in self.findings)]

    def __getitem__(self, name: str) -> Finding:
        """The finding of that name."""
        return next(finding for finding in self.findings if finding.name == name)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready: the document of ``brdf-fitter check --json``."""
        return {
            "kind": KIND, "name": self.name, "hash": self.hash, "verdict": self.verdict,
            "samples": self.samples, "looked_at": self.looked_at, "seed": self.seed,
            "findings": [finding.to_dict() for finding in self.findings],
        }  # fmt: skip


def check(table: Table | LargeTable, *, seed: int = SEED) -> Check:
    """Judge a measured table: noise, reciprocity, energy, missing regions, faulty values, conventions.

    Nothing is fitted and nothing is changed. Values that the table masks as negative or repeated are looked
    at, too. ``docs/quality.md`` explains every finding and its limits.

    Of a LargeTable the counts are of all samples; what rests on directions is judged by its sample.

    Parameters
    ----------
    seed : of the subsets that large tables are judged by; the same seed gives the same findings.
    """
    with np.errstate(over="ignore", under="ignore"):
        if isinstance(table, LargeTable):
            return _check_large(table, seed)
        return _check(table, seed)


def _check_large(table: LargeTable, seed: int) -> Check:
    shown = _check(table.sample, seed)
    findings = [finding for finding in shown.findings if finding.name not in large.REPLACED]
    return Check(
        table.metadata.name, table.hash, len(table), shown.looked_at, table.seed,
        (*large.counts(table), *findings),
    )  # fmt: skip


def _check(table: Table, seed: int) -> Check:
    measured = Measured.of(table, seed)
    repeated = noise.scatter(measured)
    neighbours = noise.smoothness(measured)
    level = noise.estimate(repeated, neighbours)
    spheres = hemispheres(measured)
    swapped = pairs.reciprocal_pairs(measured)
    findings = (
        noise.repeatability(repeated),
        noise.smooth(neighbours),
        values.negatives(measured, None if neighbours is None else neighbours.floor),
        values.fill_values(measured),
        regions.domain(measured),
        regions.blind_spots(measured),
        regions.holes(spheres),
        grazing.grazing(measured, neighbours),
        energy.reflectance(measured, spheres),
        pairs.reciprocity(measured, swapped, level),
        pairs.quantity(measured, swapped, level),
        pairs.isotropy(measured, _noise_apart(measured, repeated, level)),
        peaks.convention(measured),
        peaks.lobe_width(measured),
    )
    return Check(
        table.metadata.name, table.hash, int(measured.keep.sum()), len(measured.rows), seed, findings
    )


def _noise_apart(
    measured: Measured, repeated: noise.Scatter | None, level: noise.Noise | None
) -> noise.Noise | None:
    """The noise to judge isotropy by: an anisotropy must not count as noise among turned neighbours."""
    one_azimuth = bool((np.abs(measured.wi[:, 1]) < AT_NORMAL).all())
    if not measured.isotropic or measured.table.grid is not None or one_azimuth:
        return level
    return noise.estimate(repeated, noise.smoothness(measured, apart=True))
