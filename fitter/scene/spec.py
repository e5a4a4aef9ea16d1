"""SceneSpec: what a scene file holds. Its JSON schema is published as docs/scene.schema.json.

Lengths are in any one unit, positions in one right-handed frame of the world. Shapes are one-sided: a plane,
a plate and a mesh are seen from the side that their normal points to, a sphere from outside; materials that
transmit are seen from both. Light is stated per channel, one number for all or one each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from fitter.errors import SpecError
from fitter.model_spec import Frozen, ModelSpec

__all__ = [
    "AreaLight", "Camera", "Channels", "DirectionalLight", "Environment", "Light", "Material", "Mesh",
    "Plane", "Plate", "PointLight", "SceneSpec", "Shape", "Sphere", "scene_spec",
]  # fmt: skip

#: Within these single precision holds products of lengths, and squares of them.
Finite = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Positive = Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
_Level = Annotated[float, Field(ge=0, le=1e12, allow_inf_nan=False)]
#: Of light: one number for all channels, or one each.
Channels = _Level | Annotated[tuple[_Level, ...], Field(min_length=1)]
Name = Annotated[str, Field(min_length=1, max_length=100)]
Pixels = Annotated[int, Field(ge=1, le=4096)]

#: So small beside 1 that a direction is none.
_NO_LENGTH = 1e-12


def _direction(name: str, vector: Vector | None) -> None:
    if vector is not None and math.hypot(*vector) < _NO_LENGTH:
        raise ValueError(f"{name} has no length: give a direction")


def _not_along(tangent: Vector | None, normal: Vector, name: str = "tangent", of: str = "normal") -> None:
    if tangent is None:
        return
    (a, b, c), (x, y, z) = tangent, normal
    across = math.hypot(b * z - c * y, c * x - a * z, a * y - b * x)
    if across < 1e-6 * math.hypot(*tangent) * math.hypot(*normal):
        raise ValueError(f"{name} points along the {of}: give one across it")


class Camera(Frozen):
    """A pinhole camera. ``fov_deg`` is the whole vertical angle of view."""

    position: Vector
    look_at: Vector
    up: Vector = (0.0, 0.0, 1.0)
    fov_deg: Annotated[float, Field(gt=0, lt=179)] = 40.0
    width: Pixels = 128
    height: Pixels = 96

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        view: Vector = tuple(b - a for a, b in zip(self.position, self.look_at, strict=True))  # pyright: ignore[reportAssignmentType]
        if math.hypot(*view) < _NO_LENGTH:
            raise ValueError("the camera looks at where it stands: move look_at or position")
        _direction("up", self.up)
        _not_along(self.up, view, "up", "direction of view")
        return self


class Material(Frozen):
    """What a shape is made of: one of ``fit``, ``table``, ``compressed`` and ``model``.

    Beside a ``table`` a ``compressed`` one and a ``fit`` may be given, and beside a compressed one a fit: a
    plan may use them in its place (:attr:`stand_ins`).

    fit : a result file that ``brdf-fitter fit --out`` wrote.
    table : a measured table, read with ``options`` (quantity, convention, ...), drawn from as it is.
    compressed : a table that ``brdf-fitter compress`` wrote. model : a short name or a specification, with
    ``values`` of its parameters (one each or one per channel; those left out take their default).

    Over HTTP ``fit`` is the id of a model and ``table`` that of a table.
    """

    fit: str | None = Field(None, min_length=1, max_length=1000)
    table: str | None = Field(None, min_length=1, max_length=1000)
    options: Mapping[str, Any] = Field(default_factory=dict)
    compressed: str | None = Field(None, min_length=1, max_length=1000)
    model: ModelSpec | Name | None = None
    values: Mapping[str, Number | tuple[Number, ...]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        given = [name for name in ("fit", "table", "compressed", "model") if getattr(self, name) is not None]
        if not given or (self.model is not None and len(given) > 1):
            raise ValueError(
                f"give exactly one of fit, table, compressed and model, not {len(given)} (only beside a "
                "table its compressed form and a fit may stand)"
            )
        if self.values and self.model is None:
            raise ValueError("values belong to a model that is given inline")
        if self.options and self.table is None:
            raise ValueError("options are those that a table is read with")
        return self

    @property
    def rendered(self) -> Material:
        """What it is, alone."""
        return self._only("table" if self.table else "compressed") if self.table or self.compressed else self

    @property
    def stand_ins(self) -> tuple[Material, ...]:
        """What may take its place, the cheapest first."""
        fit = [self._only("fit")] if self.fit and (self.table or self.compressed) else []
        return (*fit, *([self._only("compressed")] if self.compressed and self.table else []))

    def _only(self, name: str) -> Material:
        kept = {name, "options"} if name == "table" else {name}
        default = {key: field.get_default(call_default_factory=True) for key, field in
            type(self).model_fields.items() if key not in kept}  # fmt: skip
        return self.model_copy(update=default)


class _Flat(Frozen):
    """A rectangle of ``size`` (along the tangent, across it) about ``center``."""

    center: Vector = (0.0, 0.0, 0.0)
    normal: Vector = (0.0, 0.0, 1.0)
    tangent: Vector | None = Field(
        None, description="the sample's own x axis; projected onto the plane. Default: near the world's x"
    )
    size: tuple[Positive, Positive]

    @model_validator(mode="after")
    def _oriented(self) -> Self:
        _direction("normal", self.normal)
        _direction("tangent", self.tangent)
        _not_along(self.tangent, self.normal)
        return self


class Plane(_Flat):
    """A flat rectangle."""

    kind: Literal["plane"] = "plane"
    material: Name


class Plate(_Flat):
    """A displaced plate: flat triangles between heights on a grid, rows along the tangent's left-hand side.

    ``heights`` are along the normal, ``heights[j][i]`` at column i along the tangent and row j across it.
    """

    kind: Literal["plate"] = "plate"
    material: Name
    heights: Annotated[tuple[Annotated[tuple[Finite, ...], Field(min_length=2)], ...], Field(min_length=2)]

    @model_validator(mode="after")
    def _rectangular(self) -> Self:
        if len({len(row) for row in self.heights}) > 1:
            raise ValueError("the rows of heights differ in length")
        return self


class Sphere(Frozen):
    """A sphere. The sample's x axis runs along circles of latitude about the world's z axis."""

    kind: Literal["sphere"] = "sphere"
    material: Name
    center: Vector = (0.0, 0.0, 0.0)
    radius: Positive


class Mesh(Frozen):
    """Flat triangles: of a Wavefront OBJ file, or ``vertices`` and ``triangles`` (from 0) themselves."""

    kind: Literal["mesh"] = "mesh"
    material: Name
    obj: str | None = Field(None, min_length=1, max_length=1000)
    vertices: tuple[Vector, ...] | None = None
    triangles: tuple[tuple[int, int, int], ...] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        inline = self.vertices is not None, self.triangles is not None
        if (self.obj is not None) == any(inline) or any(inline) != all(inline):
            raise ValueError("give obj, or vertices with triangles")
        return self


class DirectionalLight(Frozen):
    """Parallel light from ``direction`` (towards the light); irradiance on a surface facing it, W/m2."""

    kind: Literal["directional"] = "directional"
    direction: Vector
    irradiance: Channels

    @model_validator(mode="after")
    def _directed(self) -> Self:
        _direction("direction", self.direction)
        return self


class PointLight(Frozen):
    """A point; radiant intensity, W/sr."""

    kind: Literal["point"] = "point"
    position: Vector
    intensity: Channels


class AreaLight(_Flat):
    """A rectangle that shines to the side of its normal; radiance, W/(m2 sr). It casts no shadow itself."""

    kind: Literal["area"] = "area"
    radiance: Channels

    @model_validator(mode="before")
    @classmethod
    def _some_size(cls, given: Any) -> Any:
        size = given.get("size") if isinstance(given, Mapping) else None
        if isinstance(size, list | tuple) and any(side == 0 for side in size):
            raise ValueError("an area light of zero size shines nothing: use a point light")
        return given


class Environment(Frozen):
    """Light from everywhere: a latitude-longitude picture (OpenEXR), or one ``radiance``, W/(m2 sr).

    Rows of the picture go from the world's +z down to -z, columns from azimuth 0 (+x) through +y.
    """

    kind: Literal["environment"] = "environment"
    file: str | None = Field(None, min_length=1, max_length=1000)
    radiance: Channels | None = None
    scale: Positive = 1.0

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.file is None) == (self.radiance is None):
            raise ValueError("give file or radiance")
        return self


Shape = Annotated[Plane | Plate | Sphere | Mesh, Field(discriminator="kind")]
Light = Annotated[DirectionalLight | PointLight | AreaLight | Environment, Field(discriminator="kind")]


class SceneSpec(Frozen):
    """A scene. ``tolerance`` is the relative error that a plan may make (see docs/scenes.md)."""

    camera: Camera
    shapes: Annotated[tuple[Shape, ...], Field(min_length=1, max_length=1000)]
    lights: Annotated[tuple[Light, ...], Field(min_length=1, max_length=100)]
    materials: Annotated[Mapping[Name, Material], Field(min_length=1)]
    channels: Annotated[tuple[Name, ...], Field(min_length=1, max_length=100)] = ("R", "G", "B")
    tolerance: Annotated[float, Field(gt=0, lt=1)] = 0.01
    bounces: Annotated[int, Field(ge=0, le=16)] = Field(
        1, description="reflections between shapes beyond the first"
    )
    light_samples: Annotated[int, Field(ge=1, le=64)] = Field(
        4, description="samples of each area light or environment at each point"
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if len(set(self.channels)) < len(self.channels):
            raise ValueError("a channel is named twice")
        for k, shape in enumerate(self.shapes):
            if shape.material not in self.materials:
                raise ValueError(
                    f"shape {k} is made of {shape.material!r}, and the materials are "
                    f"{', '.join(map(repr, self.materials))}"
                )
        used = {shape.material for shape in self.shapes}
        for name in self.materials:
            if name not in used:
                raise ValueError(f"no shape is made of the material {name!r}")
        if sum(light.kind == "environment" for light in self.lights) > 1:
            raise ValueError("there can be one environment only")
        for k, light in enumerate(self.lights):
            for name in ("irradiance", "intensity", "radiance"):
                level = getattr(light, name, None)
                if isinstance(level, tuple) and len(level) not in (1, len(self.channels)):  # pyright: ignore[reportUnknownArgumentType]
                    raise ValueError(
                        f"light {k} has {len(level)} values of {name}, and the scene has "  # pyright: ignore[reportUnknownArgumentType]
                        f"{len(self.channels)} channels"
                    )
        return self


def scene_spec(document: Mapping[str, Any] | SceneSpec) -> SceneSpec:
    """The scene of a JSON-like mapping. Raises SpecError naming the field."""
    if isinstance(document, SceneSpec):
        return document
    try:
        return SceneSpec.model_validate(document)
    except ValidationError as error:
        # A misspelt key is told rather than the one that is missing for it.
        strange = [one for one in error.errors() if one["type"] == "extra_forbidden"]
        first = (strange or error.errors())[0]
        where = ".".join(str(part) for part in first["loc"]) or None
        message = "there is no such key" if strange else first["msg"].removeprefix("Value error, ")
        raise SpecError(
            message, code="bad-scene", parameter=where, remedy="docs/scenes.md says what a scene holds"
        ) from error


def schema() -> dict[str, Any]:
    """The published JSON schema of a scene file."""
    found: dict[str, Any] = SceneSpec.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **found}
