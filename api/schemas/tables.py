"""Uploaded tables."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from api.schemas.common import ID


class TableDocument(BaseModel):
    """An uploaded table: what its bytes were read as."""

    id: str = Field(examples=[ID])
    name: str
    created: str
    sha256: str
    bytes: int
    options: dict[str, Any] = Field(description="the reading options it was uploaded with")
    description: dict[str, Any] = Field(
        description="format, quantity, channels, counts, grid, domain, peaks, notes"
    )
    links: dict[str, str]


class InfoDocument(BaseModel):
    """A table at first sight, as ``brdf-fitter info --json`` prints it."""

    model_config = ConfigDict(extra="allow")

    kind: Literal["brdf-fitter/table"]
    format: str
    quantity: str
    channels: list[dict[str, Any]]
    noise: dict[str, Any]
    blind_spots: dict[str, Any]


class FindingDocument(BaseModel):
    """What one quality check found. ``judged`` is false where the table lacks what the check needs."""

    name: str
    verdict: Literal["ok", "notice", "warning"]
    judged: bool
    sentence: str
    numbers: dict[str, Any] = Field(description="what the sentence rests on; names carry the unit")


class CheckDocument(BaseModel):
    """The quality of a measured table. ``verdict`` is the most serious one of the findings."""

    kind: Literal["brdf-fitter/check"]
    name: str
    hash: str
    verdict: Literal["ok", "notice", "warning"]
    samples: int = Field(description="measured: finite and above the horizon, negative and repeated ones too")
    looked_at: int = Field(description="of those, the ones whose directions were used, drawn with the seed")
    seed: int
    findings: list[FindingDocument]
