"""Health: is the server there, can it work, what has it done."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response
from sqlalchemy.exc import SQLAlchemyError

import fitter
from api import metrics, schemas
from api.access import Here
from api.problems import Problem
from api.routes import problems

router = APIRouter(tags=["health"])


_WELL = {"status": "ok", "version": fitter.__version__}
_COUNTED = """# HELP brdf_jobs Rows kept.
# TYPE brdf_jobs gauge
brdf_jobs{state="queued"} 3.0
"""
EXAMPLES = {"/healthz": _WELL, "/readyz": _WELL, "/metrics": _COUNTED}


@router.get("/healthz", response_model=schemas.Health)
def healthz() -> dict[str, Any]:
    """The process answers."""
    return _WELL


@router.get("/readyz", response_model=schemas.Health, responses=problems(503))
def readyz(here: Here) -> dict[str, Any]:
    """The database answers, and the server is not stopping."""
    try:
        here.service.store.ping()
    except SQLAlchemyError as error:
        raise Problem(503, "not-ready", "the database does not answer") from error
    if here.service.stopping.is_set():
        raise Problem(503, "not-ready", "the server is stopping")
    return _WELL


@router.get(
    "/metrics", response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)  # fmt: skip
def prometheus(here: Here) -> Response:
    """Counters for Prometheus."""
    return Response(here.service.metrics.text(here.service.store.counts()), media_type=metrics.MEDIA_TYPE)
