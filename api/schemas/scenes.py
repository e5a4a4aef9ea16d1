"""Scenes, their plans and pictures."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from api.schemas.common import ID, Request, Seed

_SCENE: dict[str, Any] = {
    "camera": {"position": [0, -4, 2], "look_at": [0, 0, 0], "width": 16, "height": 12},
    "channels": ["value"],
    "materials": {"matte": {"model": "lambert", "values": {"kd": 0.5}}},
    "shapes": [{"kind": "sphere", "radius": 1.0, "material": "matte"}],
    "lights": [{"kind": "directional", "direction": [1, -1, 2], "irradiance": 1.0}],
}


#: Checked by fitter.scene.scene_spec, whose errors name the field.
SceneDocument = Annotated[
    dict[str, Any],
    Field(description="a scene: its JSON schema is docs/scene.schema.json; `fit` and `table` are ids here"),
]


Tiles = Annotated[
    tuple[Annotated[int, Field(ge=1, le=64)], Annotated[int, Field(ge=1, le=64)]],
    Field(description="of the plan: columns and rows; up to three programs are made for them"),
]


class PlanRequest(Request):
    """A scene, and what its plan may change: `tolerance` is the scene's own where it is left out."""

    model_config = ConfigDict(json_schema_extra={"example": {"scene": _SCENE, "tolerance": 0.01}})

    scene: SceneDocument
    tolerance: Annotated[float, Field(gt=0, lt=1)] | None = None
    seed: Seed = 0
    precision: Literal["float32", "float64", "auto"] = "float32"
    tiles: Tiles = (1, 1)


class RenderRequest(Request):
    """A scene to render. With `plan` effects that its tolerance allows are left out."""

    model_config = ConfigDict(json_schema_extra={"example": {"scene": _SCENE, "samples": 4, "seed": 1}})

    scene: SceneDocument
    samples: Annotated[int, Field(ge=1, le=1_000_000)] | None = Field(None, description="a pixel")
    seconds: Annotated[float, Field(gt=0, le=3600)] = 60.0
    target_error: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        None, description="root mean square of the standard errors over F"
    )
    seed: Seed = 0
    precision: Literal["float32", "float64", "auto"] = Field(
        "float32", description="auto: what the plan finds to do"
    )
    plan: bool = False
    tiles: Tiles = (1, 1)
    layers: bool = Field(False, description="one layer in the OpenEXR file for each effect")

    @model_validator(mode="after")
    def _planned(self) -> Self:
        if self.precision == "auto" and not self.plan:
            raise ValueError("precision auto is a plan's choice: ask for plan, or give float32 or float64")
        return self


class PlanDocument(BaseModel):
    """A plan, as ``brdf-fitter scene plan --json`` prints it."""

    model_config = ConfigDict(extra="allow")

    kind: Literal["brdf-fitter/plan"]
    tolerance: float
    bound: float = Field(description="of the error of all that is proved to be small enough, together")
    estimated: float = Field(description="the error of all that was tried at random points only, together")
    reference: float = Field(description="F: errors are relative to max(L, 0.01 F)")
    decisions: list[dict[str, Any]]
    programs: list[dict[str, Any]] = Field(description="of the tiles, where there are several")
    operations: dict[str, float]


class SceneSummary(BaseModel):
    """One rendered scene in a list."""

    id: str = Field(examples=[ID])
    created: str
    job: str
    width: int
    height: int
    samples: int
    seconds: float
    error: float
    stopped: str
    links: dict[str, str]


class PictureDocument(BaseModel):
    """What was rendered, as ``brdf-fitter scene render --json`` prints it, with its id and links."""

    model_config = ConfigDict(extra="allow")

    id: str
    kind: Literal["brdf-fitter/picture"]
    samples: int
    error: float
    history: list[dict[str, Any]]
    notes: list[str]
    plan: dict[str, Any] | None
    links: dict[str, str]


class DifferenceDocument(BaseModel):
    """Two pictures, channel by channel: `error` and `noise` (root mean squares), `error_without_noise` and
    `bias`, all over the first one's F, and `psnr_db`."""

    numbers: list[dict[str, Any]]
    reference: float = Field(description="F of the first picture, W/(m2 sr)")
