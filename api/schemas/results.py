"""Fits, posteriors, calibrations and tradeoffs."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from api.schemas.common import ID


class FitSummary(BaseModel):
    """One fit in a list."""

    id: str = Field(examples=[ID])
    model: str
    created: str
    table: str
    job: str
    status: str
    message: str
    metrics: dict[str, float | None]
    seconds: float
    links: dict[str, str]


class FitDocument(BaseModel):
    """The whole result, as ``brdf-fitter fit --json`` prints it, with its id and links."""

    model_config = ConfigDict(extra="allow")

    id: str
    kind: Literal["brdf-fitter/fit"]
    model: dict[str, Any]
    parameters: dict[str, Any]
    metrics: dict[str, Any]
    status: str
    message: str
    posteriors: list[str]
    links: dict[str, str]


class PosteriorSummary(BaseModel):
    """One posterior in a list."""

    id: str = Field(examples=[ID])
    created: str
    fit: str
    job: str
    status: str
    message: str
    seconds: float
    links: dict[str, str]


class CalibrationSummary(PosteriorSummary):
    """One calibration in a list."""


class PosteriorDocument(BaseModel):
    """The whole posterior, as ``brdf-fitter posterior --json`` prints it, with its id and links."""

    model_config = ConfigDict(extra="allow")

    id: str
    kind: Literal["brdf-fitter/posterior"]
    labels: list[str]
    draws: list[list[float | None]]
    intervals: dict[str, Any]
    diagnostics: dict[str, Any]
    status: str
    message: str
    links: dict[str, str]


class CalibrationDocument(BaseModel):
    """The whole calibration, as ``brdf-fitter calibrate --json`` prints it, with its id and links."""

    model_config = ConfigDict(extra="allow")

    id: str
    kind: Literal["brdf-fitter/calibration"]
    status: Literal["calibrated", "not_calibrated", "too_few_simulations"]
    message: str
    simulations: int
    failed: int
    labels: list[str]
    rows: list[dict[str, Any]]
    links: dict[str, str]


class TradeoffSummary(BaseModel):
    """One tradeoff in a list."""

    id: str = Field(examples=[ID])
    created: str
    table: str
    job: str
    models: list[str]
    points: int
    seconds: float
    links: dict[str, str]


class TradeoffDocument(BaseModel):
    """The whole tradeoff, as ``brdf-fitter tradeoff --json`` prints it, with its id and links."""

    model_config = ConfigDict(extra="allow")

    id: str
    kind: Literal["brdf-fitter/tradeoff"]
    points: list[dict[str, Any]]
    compression: list[dict[str, Any]]
    posterior: dict[str, Any] | None
    skipped: list[str]
    links: dict[str, str]
