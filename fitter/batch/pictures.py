"""Small pictures of a fit for the index: one slice, one plot of residuals."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from fitter.documents import write_bytes

if TYPE_CHECKING:
    from fitter.fitting import FitResult
    from fitter.table import Table

#: Dots per inch: a picture is some 250 pixels wide.
_DPI = 45
SLICE, RESIDUALS = "slice.png", "residuals.png"


def draw(table: Table, fit: FitResult, place: Path) -> None:
    """Write ``slice.png`` (where the table has samples near the plane of incidence) and ``residuals.png``."""
    from fitter.report import figures, residuals, slices
    from fitter.report.clean import clean
    from fitter.report.fitted import Fitted

    fitted = Fitted.of(table, fit)
    record = clean(
        {
            "slices": slices.section(fitted, None, None, fit.spec.seed),
            "residuals": residuals.section(fitted, fit.spec.seed),
        }
    )
    cuts = figures.slice_pictures(record)
    for name, pictures in ((SLICE, cuts[len(cuts) // 2 :]), (RESIDUALS, figures.residual_pictures(record))):
        if pictures:
            stream = io.BytesIO()
            pictures[0].figure.savefig(stream, format="png", dpi=_DPI)
            write_bytes(stream.getvalue(), place / name)
