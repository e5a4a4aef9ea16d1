"""Jobs, and the requests that start them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from api.schemas.common import ID, Label
from fitter.spec import CalibrationSpec, FitSpec, ModelSpec, PosteriorSpec, TradeoffSpec


class FitRequest(FitSpec):
    """A fit to a table: ``model`` (a short name or its specification) or several ``models``.

    ``model`` "auto" compares models, ``candidates`` where they are named, on scans held out in ``folds``.
    """

    model_config = ConfigDict(
        allow_inf_nan=False,
        json_schema_extra={
            "example": {"table": ID, "models": ["ward", "lafortune:2"], "metric": "cosine", "seed": 0}
        },
    )

    table: str = Field(max_length=64, description="id of the table")
    model: ModelSpec | Label | None = None  # pyright: ignore[reportIncompatibleVariableOverride, reportGeneralTypeIssues]
    models: Annotated[list[ModelSpec | Label], Field(min_length=1, max_length=16)] | None = None
    candidates: Annotated[list[ModelSpec | Label], Field(min_length=1, max_length=32)] | None = None
    folds: Annotated[int, Field(ge=3, le=20)] = 5
    budget_seconds: Annotated[float, Field(gt=0, le=86_400)] | None = None


class PosteriorRequest(PosteriorSpec):
    """A posterior of a finished fit."""

    model_config = ConfigDict(
        allow_inf_nan=False,
        json_schema_extra={"example": {"fit": ID, "ess": 400, "budget_seconds": 20}},
    )

    fit: str = Field(max_length=64, description="id of the fit")


class CalibrationRequest(CalibrationSpec):
    """Simulations of a finished fit's model on the directions of its table."""

    model_config = ConfigDict(
        allow_inf_nan=False,
        json_schema_extra={"example": {"fit": ID, "simulations": 100, "time_limit_seconds": 300}},
    )

    fit: str = Field(max_length=64, description="id of the fit")
    simulations: Annotated[int, Field(ge=1, le=10_000)] = 200


class TradeoffRequest(TradeoffSpec):
    """What to measure on a table: see ``TradeoffSpec``. Models are short names or specifications."""

    model_config = ConfigDict(
        allow_inf_nan=False,
        json_schema_extra={
            "example": {"table": ID, "models": ["ward"], "time_limit_seconds": 30, "posterior": False}
        },
    )

    table: str = Field(max_length=64, description="id of the table")
    models: Annotated[list[ModelSpec | Label], Field(min_length=1, max_length=16)]  # pyright: ignore[reportIncompatibleVariableOverride, reportGeneralTypeIssues]
    time_limit_seconds: Annotated[float, Field(gt=0, le=3600)] = 60.0


class Progress(BaseModel):
    """How far a job is: share in [0, 1], and what it is doing."""

    share: float
    what: str


class JobDocument(BaseModel):
    """Work that takes time. ``results`` link what it made, or hold the problem of a model that failed, or the
    comparison that "auto" made."""

    id: str = Field(examples=[ID])
    kind: Literal["fit", "posterior", "calibration", "tradeoff", "scene"]
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    progress: Progress
    attempt: int
    table: str | None = Field(description="null where the work needs none")
    request: dict[str, Any]
    created: str
    started: str | None
    finished: str | None
    results: list[dict[str, Any]]
    problem: dict[str, Any] | None
    links: dict[str, str]
