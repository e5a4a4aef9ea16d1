"""Models, families, export targets, and the server's health."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from api.schemas.common import ID, Label, Request, Values
from fitter.spec import ModelSpec


class ModelRequest(Request):
    """Parameters made elsewhere: scalars, or one value per channel. Those left out take their default."""

    model_config = ConfigDict(
        json_schema_extra={
            "example": {"model": "ward", "values": {"kd": [0.1, 0.2, 0.3], "ks": 0.05, "alpha": 0.1}}
        },
    )

    model: ModelSpec | Label
    channels: Annotated[list[Label], Field(min_length=1, max_length=1000)] | None = None
    values: dict[str, float | Values]


class ModelDocument(BaseModel):
    """A reflectance model, fitted or uploaded."""

    id: str = Field(examples=[ID])
    origin: Literal["fit", "upload"]
    name: str
    created: str
    spec: dict[str, Any]
    channels: list[str]
    values: dict[str, float | list[float]]
    links: dict[str, str]


class FamilyDocument(BaseModel):
    """A model family: its options, and the parameters of one member."""

    name: str
    family: str
    spec: dict[str, Any]
    summary: str
    options: dict[str, list[str]] = Field(description="what each option may be, default first")
    max_lobes: int
    anisotropic: bool = Field(description="whether there is an anisotropic form")
    parts: list[str] = Field(description="prefixes of the parameters of the models it is built of")
    fitted: bool = Field(description="whether it is fitted to tables; the others evaluate and sample")
    reciprocal: bool
    transmits: bool
    parameters: list[dict[str, Any]]
    values_schema: dict[str, Any] = Field(description="JSON schema of `values` in POST /v1/models")


class Health(BaseModel):
    """The server answers."""

    status: Literal["ok"]
    version: str


class ExportTargetDocument(BaseModel):
    """Something a model or a table can be exported to."""

    name: str
    description: str
    models: bool
    tables: bool
    convention: str = Field(description="units and cosine of what is in the file")
    media_type: str
