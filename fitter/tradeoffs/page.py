"""The page of a tradeoff: one self-contained HTML document, the picture and every number beside it."""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING, Any

from fitter.tradeoffs.rows import COLUMNS, COMPRESSION, POSTERIOR, compression_rows, posterior_rows, rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fitter.tradeoffs.result import Tradeoff

_HEAD = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:;
 style-src 'unsafe-inline'">
<style>body{{font:15px/1.5 system-ui,sans-serif;max-width:75rem;margin:2rem auto;padding:0 1rem;color:#222}}
img{{max-width:100%;height:auto}}table{{border-collapse:collapse}}td,th{{padding:.2em .7em;text-align:left;
border-bottom:1px solid #ddd}}.scroll{{overflow-x:auto}}</style></head><body>
<h1>{title}</h1>
"""
_ERRORS = (
    "Held out: relative rms difference from incidences that no fit saw; it holds the model's misfit and the "
    "noise as well. Parameters: largest distance from the reference fit of the same model and metric, in "
    "standard uncertainties. Reflectance: largest relative difference of the directional-hemispherical "
    "reflectance. Seconds are of warm fits; compiling happens once a process. A star marks the Pareto front "
    "of error and seconds."
)


def render(tradeoff: Tradeoff) -> str:
    """The page."""
    title = escape(f"What accuracy costs: {tradeoff.table['name'] or 'table'}")
    picture = base64.b64encode(tradeoff.picture("png")).decode("ascii")
    parts = [
        _HEAD.format(title=title),
        f'<p><img src="data:image/png;base64,{picture}" alt="Error against seconds, in numbers below."></p>',
        f"<p>{escape(_ERRORS)} {escape(str(tradeoff.noise['sentence']).capitalize())}.</p>",
        _table(COLUMNS, rows(tradeoff)),
    ]
    for one in tradeoff.references:
        parts.append(f"<p>{escape(said_of_reference(one))}</p>")
    if tradeoff.compression:
        parts += ["<h2>Compression</h2>", _table(COMPRESSION, compression_rows(tradeoff))]
    if tradeoff.posterior is not None:
        parts += ["<h2>Posterior</h2>", _table(POSTERIOR, posterior_rows(tradeoff))]
    if tradeoff.skipped:
        parts.append(f"<p>Left out by the time limit: {escape(', '.join(tradeoff.skipped))}.</p>")
    parts += [f"<p>{escape(note)}</p>" for note in tradeoff.notes]
    machine = ", ".join(f"{name} {value}" for name, value in tradeoff.machine.items())
    parts.append(f"<p>Measured on {escape(machine)}, in {tradeoff.seconds:.0f} s.</p></body></html>\n")
    return "\n".join(parts)


def said_of_reference(one: Any) -> str:
    """How thoroughly a reference was looked for, in a sentence."""
    agree = ", ".join(f"{a} of {n}" for a, n in one["starts_that_agree"])
    text = f"Reference of {one['model']} ({one['metric']}): {agree} starts agree"
    scan = one["scan"]
    if scan is not None:
        text += (
            f"; an exhaustive scan of {scan['nodes']:,} nodes found {scan['minima']} minima, its lowest node "
            f"{scan['best_node']:+.2g} of the objective away"
        )
        if one["metric"] in ("log", "cbrt"):
            # Two objectives, so that a node may be a little lower without there being a better optimum.
            text += " (of the tangent that the search sees, not of the metric itself)"
    return text + "."


def _table(columns: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    lines = ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in body]
    inside = "".join(f"<tr>{line}</tr>" for line in lines)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{inside}</tbody></table></div>'
