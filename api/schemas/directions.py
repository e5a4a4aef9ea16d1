"""Directions, values at them, and draws."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from api.schemas.common import Request, Seed, Values, Vector


class SampleRequest(Request):
    """Directions to draw for one incidence."""

    model_config = ConfigDict(json_schema_extra={"example": {"wi": [0.6, 0.0, 0.8], "n": 4, "seed": 1}})

    wi: Vector
    n: Annotated[int, Field(ge=1, le=50_000_000)]
    seed: Seed


class TableSampleRequest(Request):
    """Directions to draw from a raw table. ``weights`` of the channels default to equal."""

    model_config = ConfigDict(json_schema_extra={"example": {"wi": [0.5, 0.0, 0.8660254], "n": 4, "seed": 1}})

    wi: Vector | Annotated[list[Vector], Field(min_length=1, max_length=1000)] | None = Field(
        None,
        description="one incidence, or several with `n` draws each; left out, incidences are drawn, too, "
        "density proportional to f_r cos(theta_i) cos(theta_o)",
    )
    n: Annotated[int, Field(ge=1, le=50_000_000)]
    seed: Seed
    weights: Values | None = None
    method: Literal["rejection", "inversion"] | None = Field(
        None, description="how; default whichever is faster. Both are exact"
    )
    max_evaluations: Annotated[int, Field(ge=1, lt=2**53)] | None = Field(
        None, description="candidates to try at most; default 20 for each draw, and a million"
    )
    allow_extrapolated: bool = Field(False, description="draw for incidences that were not measured, too")


class SliceInfoDocument(BaseModel):
    """One incidence of a raw table, as its sampler knows it."""

    integral: float = Field(description="of the interpolant times cos(theta_o), negative values taken as 0")
    integral_error: float = Field(description="its relative error, estimated; 0 where it is exact")
    energy_error: float = Field(description="what interpolation alone makes of it, relative, estimated")
    clamped_share: float = Field(description="share of the integral that is there because of that")
    coverage: float = Field(description="share of the projected hemisphere that was measured")
    blind: float = Field(description="share of the hemisphere's solid angle that is never drawn")
    cells: int
    acceptance: float = Field(description="expected share of candidates that is accepted")
    extrapolated: bool
    method: Literal["rejection", "inversion"]


class SamplesDocument(BaseModel):
    """Draws, one entry each; ``weight`` is f_r cos(theta_o) / pdf per channel."""

    channels: list[str]
    wo: list[Vector]
    pdf: list[float | None]
    weight: list[list[float | None]]
    valid: list[bool]
    is_delta: list[bool]
    acceptance: float
    evaluations: int | None = Field(description="candidates tried; null where a sampler tries none")
    seed: int | None
    wi: list[Vector] | None = Field(description="the incidence of each draw; null where there is one for all")
    slices: list[SliceInfoDocument] | None = Field(
        description="each incidence of a raw table; null for models, for pairs, and of more than 16"
    )


class EvaluationDocument(BaseModel):
    """f_r without the cosine, one row per pair and one column per channel; null where there is none."""

    channels: list[str]
    unit: Literal["1/sr"]
    values: list[list[float | None]]


class TableEvaluationDocument(EvaluationDocument):
    """A table's interpolant; ``extrapolated`` says which pairs lie outside the measured domain."""

    extrapolated: list[bool]


class PdfDocument(BaseModel):
    """Density of wo given wi per unit solid angle."""

    unit: Literal["1/sr"]
    values: list[float | None]


class AlbedoDocument(BaseModel):
    """Directional-hemispherical reflectance, one row per direction and one column per channel; beside it
    the transmittance, null for a model that transmits nothing."""

    channels: list[str]
    values: list[list[float | None]]
    transmittance: list[list[float | None]] | None
