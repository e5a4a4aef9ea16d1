"""The numbers of a tradeoff as rows of text: for a terminal and for its page."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fitter.tradeoffs.result import Point, Tradeoff

COLUMNS = (
    "fit", "seconds", "median", "compiling", "memory", "held out", "parameters (u)", "reflectance", "front"
)  # fmt: skip
COMPRESSION = (
    "tolerance", "bytes", "of values", "ratio", "worst error", "held out", "parameters (u)", "reflectance",
    "compress", "decompress", "fit",
)  # fmt: skip
POSTERIOR = ("effective samples", "draws", "seconds", "interval error", "status")


def rows(tradeoff: Tradeoff) -> list[list[str]]:
    """One a point, in the order in which they were measured."""
    return [_row(point) for point in tradeoff.points]


def compression_rows(tradeoff: Tradeoff) -> list[list[str]]:
    return [
        [
            f"{row['tolerance']:g}", f"{row['bytes']:,}", f"{row['value_bytes']:,}",
            _number(row["ratio"]), _number(row["worst_error"]),
            *(_number(row[kind]) for kind in ("held_out", "parameters", "reflectance")),
            *(_seconds(row[f"{what}_seconds"]) for what in ("compress", "decompress", "fit")),
        ]
        for row in tradeoff.compression
    ]  # fmt: skip


def posterior_rows(tradeoff: Tradeoff) -> list[list[str]]:
    found = [] if tradeoff.posterior is None else tradeoff.posterior["rows"]
    return [
        [
            f"{row['ess']:.0f}", f"{row['draws']:,}", _seconds(row["seconds"]),
            "the measure" if row["interval_error"] is None else _number(row["interval_error"]), row["status"],
        ]
        for row in found
    ]  # fmt: skip


def _row(point: Point) -> list[str]:
    seconds, errors = point.seconds, point.errors
    on = {name.partition("/")[0] for name in point.front if name.endswith("/seconds")}
    held_out, parameters, reflectance = (
        _number(errors.get(kind)) + (" *" if kind in on else "")
        for kind in ("held_out", "parameters", "reflectance")
    )
    memory = "-" if point.memory_bytes is None else f"{point.memory_bytes / 1e6:.1f} MB"
    return [
        point.label, *(_seconds(seconds[name]) for name in ("min", "median", "compile")), memory,
        held_out, parameters, reflectance, "*" if on else "",
    ]  # fmt: skip


def _seconds(seconds: float) -> str:
    if seconds <= 0:
        return "0"
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
