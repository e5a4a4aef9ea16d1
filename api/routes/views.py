"""Views of a table: what a person looks at, in pieces that are small however large the table is."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Query, Response

from api.access import Here, Mine
from api.routes import problems
from api.rows import TableRow
from api.schemas import views as schemas
from api.tables import Opened
from fitter.documents import dumps
from fitter.views import in_plane, lobe

router = APIRouter(prefix="/v1/tables", tags=["tables"])

ThetaI = Annotated[float, Query(ge=0, lt=90, allow_inf_nan=False)]
PhiI = Annotated[float, Query(ge=-360, le=360, allow_inf_nan=False)]


@router.get("/{id}/slices", response_model=schemas.SliceDocument, responses=problems(404, 422))
def slices(
    id: str,
    here: Here,
    theta_i_deg: ThetaI,
    phi_i_deg: PhiI = 0.0,
    n: Annotated[int, Query(ge=2, le=10_000, description="directions, from -89.5 to 89.5 degrees")] = 180,
) -> Response:
    """In-plane slice of the interpolant at one incidence; theta_o is positive on the specular side."""
    opened = _opened(here, id)
    found = in_plane(opened.table, theta_i_deg, phi_i_deg, n=n)
    return _answer(
        opened, theta_i_deg=theta_i_deg, phi_i_deg=phi_i_deg, theta_o_deg=found.theta_o_deg,
        values=found.values, extrapolated=found.extrapolated,
    )  # fmt: skip


@router.get("/{id}/cuts", response_model=schemas.CutsDocument, responses=problems(404, 422))
def measured_cuts(id: str, here: Here) -> Response:
    """The samples near the plane of incidence at up to six incidences, as measured, nothing interpolated.

    The first call looks at every sample; what it found is kept with the table.
    """
    opened = _opened(here, id)
    found = opened.views.cuts()
    cuts = [
        {"theta_i_deg": one.theta_i_deg, "theta_o_deg": one.theta_o_deg, "values": one.channels}
        for one in found.cuts
    ]
    return _answer(opened, plane_deg=found.plane_deg, azimuth_deg=found.azimuth_deg, cuts=cuts)


@router.get("/{id}/lobe", response_model=schemas.LobeDocument, responses=problems(404, 422))
def hemisphere(
    id: str,
    here: Here,
    theta_i_deg: ThetaI,
    phi_i_deg: PhiI = 0.0,
    step_deg: Annotated[
        float, Query(ge=1, le=15, allow_inf_nan=False, description="between nodes; of azimuths twice that")
    ] = 3.0,
) -> Response:
    """The interpolant over the scattered hemisphere at one incidence, denser around the mirror direction.

    `turn_deg` counts from the azimuth of the light: 180 is the specular side. Values have seven digits.
    """
    opened = _opened(here, id)
    found = lobe(opened.table, theta_i_deg, phi_i_deg, step_deg=step_deg)
    return _answer(
        opened, theta_i_deg=theta_i_deg, phi_i_deg=phi_i_deg, theta_o_deg=found.theta_o_deg,
        turn_deg=found.turn_deg, values=_short(found.values), extrapolated=found.extrapolated,
    )  # fmt: skip


@router.get(
    "/{id}/half-difference", response_model=schemas.HalfDifferenceDocument, responses=problems(404, 422)
)
def half_difference(id: str, here: Here) -> Response:
    """The whole table over half and difference angle: means of the usable samples, null where there are none.

    Of a large grid in other angles a part is looked at, drawn with a fixed seed. Kept with the table.
    """
    opened = _opened(here, id)
    found = opened.views.half_difference()
    return _answer(
        opened, theta_h_deg=found.theta_h_deg, theta_d_deg=found.theta_d_deg, values=_short(found.values),
        samples=np.ascontiguousarray(found.samples), looked_at=found.looked_at,
    )  # fmt: skip


@router.get("/{id}/coverage", response_model=schemas.CoverageDocument, responses=problems(404, 422))
def coverage(id: str, here: Here) -> Response:
    """How many usable and masked samples lie in each cell of theta_i (rows) and theta_o (columns).

    Of a large grid a part is looked at, drawn with a fixed seed. Kept with the table.
    """
    opened = _opened(here, id)
    found = opened.views.coverage()
    return _answer(
        opened, theta_i_deg=found.theta_i_deg, theta_o_deg=found.theta_o_deg, usable=found.usable,
        masked=found.masked, looked_at=found.looked_at, samples=len(opened.table),
    )  # fmt: skip


def _opened(here: Mine, id: str) -> Opened:
    return here.service.tables.open(here.get(TableRow, id))


def _short(values: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float32]]:
    """For the eye: half of the text."""
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(values, np.float32)


def _answer(opened: Opened, **fields: Any) -> Response:
    channels = [channel.name for channel in opened.table.channels]
    document = {"channels": channels, "unit": "1/sr", **fields}
    return Response(dumps(document), media_type="application/json")
