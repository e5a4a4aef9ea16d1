"""check of a table that stays in its file: what was counted over all samples, beside what a sample shows."""

from __future__ import annotations

from typing import Any

from fitter.large import LargeTable
from fitter.quality.finding import Finding, Verdict, counted, not_judged, percent
from fitter.quality.values import MANY_NEGATIVE

#: Findings that a stratified sample can't give: it holds no repeats, and its shares are not the table's.
REPLACED = ("repeatability", "negatives", "fill_values")


def counts(table: LargeTable) -> list[Finding]:
    """The findings that rest on every sample of the file, in place of those ``REPLACED``."""
    return [samples(table), repeats(table), negatives(table), _fill_values()]


def samples(table: LargeTable) -> Finding:
    """How many samples are usable, why others are not, and the range of the values."""
    totals = table.totals
    missing = totals.samples - totals.usable
    numbers: dict[str, Any] = {
        "samples": totals.samples, "usable": totals.usable, "masked": dict(totals.masked),
        "lowest_per_sr": totals.lowest, "mean_per_sr": totals.mean, "highest_per_sr": totals.highest,
    }  # fmt: skip
    said = f"{totals.usable:,} of {totals.samples:,} samples are usable"
    reasons = ", ".join(f"{count:,} {reason}" for reason, count in totals.masked.items())
    verdict: Verdict = "warning" if 2 * missing > totals.samples else "notice" if missing else "ok"
    span = f"values from {totals.lowest.min():.3g} to {totals.highest.max():.3g}/sr"
    return Finding("samples", verdict, f"{said}{f' ({reasons})' if reasons else ''}, {span}.", numbers)


def repeats(table: LargeTable) -> Finding:
    """How many samples repeat a geometry: counted, or estimated from a share of the geometries."""
    found = table.totals.repeats
    numbers = {"repeats": found.number, "exact": found.exact, "looked_at": found.looked_at}
    if not found.number:
        seen = "No geometry was measured twice" if found.exact else "No repeat was seen"
        return Finding("repeatability", "ok", f"{seen}: the repeatability is not known.", numbers)
    about = "" if found.exact else "about "
    sentence = (
        f"{about}{counted(found.number, 'sample repeats', 'samples repeat')} an earlier geometry and "
        "count again in a fit; their scatter was not looked at."
    )
    many = found.number > 0.01 * table.usable
    return Finding("repeatability", "notice" if many else "ok", sentence[0].upper() + sentence[1:], numbers)


def negatives(table: LargeTable) -> Finding:
    """The share of samples with a negative value, over all that the file holds."""
    totals = table.totals
    share = totals.negative / totals.samples
    numbers = {"share_of_samples": share, "samples": totals.negative}
    if not totals.negative:
        return Finding("negatives", "ok", "No value is negative.", numbers)
    verdict: Verdict = "warning" if share > MANY_NEGATIVE else "notice"
    return Finding("negatives", verdict, f"{percent(share)} of the samples have a negative value.", numbers)


def _fill_values() -> Finding:
    return not_judged("fill_values", "How often each value occurs, which shows fill values, was not counted.")
