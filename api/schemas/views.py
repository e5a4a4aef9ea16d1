"""Schemas of what is looked at of a table."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from api.schemas.directions import TableEvaluationDocument


class SliceDocument(TableEvaluationDocument):
    """In-plane slice; ``theta_o_deg`` is positive on the specular side."""

    theta_i_deg: float
    phi_i_deg: float
    theta_o_deg: list[float]


class ViewDocument(BaseModel):
    """Part of a table, f_r in 1/sr without the cosine; null where there is nothing."""

    channels: list[str]
    unit: Literal["1/sr"]


class CutDocument(BaseModel):
    """Measured in-plane samples at one incidence; ``theta_o_deg`` is positive on the specular side."""

    theta_i_deg: float
    theta_o_deg: list[float]
    values: list[list[float | None]] = Field(description="one row per angle and one column per channel")


class CutsDocument(ViewDocument):
    """Measured in-plane samples of up to six incidences."""

    plane_deg: float = Field(description="how far from the plane of incidence they lie at most")
    azimuth_deg: float | None = Field(description="of the incidence; null for an isotropic table")
    cuts: list[CutDocument]


class LobeDocument(ViewDocument):
    """The interpolant over the scattered hemisphere."""

    theta_i_deg: float
    phi_i_deg: float
    theta_o_deg: list[float]
    turn_deg: list[float] = Field(description="azimuths from that of the light; 180 is the specular side")
    values: list[list[list[float | None]]] = Field(description="by theta_o, turn and channel")
    extrapolated: list[list[bool]] = Field(description="by theta_o and turn")


class HalfDifferenceDocument(ViewDocument):
    """The table over half and difference angle, means over phi_d."""

    theta_h_deg: list[float]
    theta_d_deg: list[float]
    values: list[list[list[float | None]]] = Field(description="by theta_d, theta_h and channel")
    samples: list[list[int]] = Field(description="behind each mean, by theta_d and theta_h")
    looked_at: int


class CoverageDocument(ViewDocument):
    """Samples in cells of the polar angles, whose edges are given."""

    theta_i_deg: list[float]
    theta_o_deg: list[float]
    usable: list[list[int]] = Field(description="by theta_i and theta_o")
    masked: list[list[int]] = Field(description="by theta_i and theta_o")
    looked_at: int = Field(description="usable samples that were counted")
    samples: int = Field(description="of the table, usable or not")


class ResidualsDocument(BaseModel):
    """The residuals of a fit, as in its report."""

    model_config = ConfigDict(extra="allow")

    definition: str
    samples: int
    per_channel: list[dict[str, Any]]
    shown: list[str] = Field(description="channels that are drawn")
    map: dict[str, Any]
    further_maps: list[dict[str, Any]]


class FitSlicesDocument(BaseModel):
    """In-plane samples and the fitted curve, as in a fit's report."""

    plane_tolerance_deg: float
    azimuth_deg: float | None
    channels: list[str]
    level: float | None
    predictive_level: float | None
    slices: list[dict[str, Any]]
