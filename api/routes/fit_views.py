"""Views of a fit beside its data: what its report shows of them, without the rest of the report."""

from __future__ import annotations

from fastapi import APIRouter, Response

from api.access import Here, Mine
from api.routes import problems
from api.routes.fits import fit_row, with_table
from api.rows import TableRow
from api.schemas import views as schemas
from fitter.documents import dumps
from fitter.fitting import FitResult
from fitter.report.clean import clean
from fitter.report.fitted import Fitted

router = APIRouter(prefix="/v1/fits", tags=["fits"])


@router.get(
    "/{id}/residuals", response_model=schemas.ResidualsDocument, responses=problems(404, 409, 422)
)  # fmt: skip
def residuals(id: str, here: Here) -> Response:
    """Relative residuals of a fit: against angles, as maps, and how systematic they are; as in its report."""
    from fitter.report.residuals import section

    fitted = _fitted(here, id)
    return _answer(section(fitted, fitted.fit.spec.seed))


@router.get(
    "/{id}/slices", response_model=schemas.FitSlicesDocument, responses=problems(404, 409, 422)
)  # fmt: skip
def slices(id: str, here: Here) -> Response:
    """Data and fit in the plane of incidence at up to six incidences, as in its report, without the bands."""
    from fitter.report.slices import section

    fitted = _fitted(here, id)
    return _answer(section(fitted, None, None, fitted.fit.spec.seed))


def _fitted(here: Mine, id: str) -> Fitted:
    """Raises Problem: 404, 409 where the table was deleted."""
    row = fit_row(here, id)
    table = here.service.tables.open(here.get(TableRow, with_table(here, row).table_id or "")).table
    return Fitted.of(table, FitResult.from_dict(here.service.results.read(row.id)))


def _answer(section: dict[str, object]) -> Response:
    return Response(dumps(clean(section)), media_type="application/json")
