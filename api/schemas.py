"""Schemas: what requests hold and answers look like. OpenAPI is made from these."""

from __future__ import annotations

from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from fitter.spec import CalibrationSpec, FitSpec, ModelSpec, PosteriorSpec, TradeoffSpec

_T = TypeVar("_T")

#: Text that is shown to people: no control characters.
Label = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]
Seed = Annotated[int, Field(ge=0, lt=2**63, description="the same seed gives the same draws")]
Values = Annotated[list[float], Field(min_length=1, max_length=1000)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3, description="unit vector [x, y, z]")]

_ID = "0123456789abcdef0123456789abcdef"


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Page(BaseModel, Generic[_T]):
    """Part of a list, newest first."""

    items: list[_T]
    total: int
    limit: int
    offset: int


class TableDocument(BaseModel):
    """An uploaded table: what its bytes were read as."""

    id: str = Field(examples=[_ID])
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


class SampleRequest(_Request):
    """Directions to draw for one incidence."""

    model_config = ConfigDict(json_schema_extra={"example": {"wi": [0.6, 0.0, 0.8], "n": 4, "seed": 1}})

    wi: Vector
    n: Annotated[int, Field(ge=1, le=50_000_000)]
    seed: Seed


class TableSampleRequest(_Request):
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


class FitRequest(FitSpec):
    """A fit to a table: ``model`` (a short name or its specification) or several ``models``.

    ``model`` "auto" compares models, ``candidates`` where they are named, on scans held out in ``folds``.
    """

    model_config = ConfigDict(
        allow_inf_nan=False,
        json_schema_extra={
            "example": {"table": _ID, "models": ["ward", "lafortune:2"], "metric": "cosine", "seed": 0}
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
        json_schema_extra={"example": {"fit": _ID, "ess": 400, "budget_seconds": 20}},
    )

    fit: str = Field(max_length=64, description="id of the fit")


class CalibrationRequest(CalibrationSpec):
    """Simulations of a finished fit's model on the directions of its table."""

    model_config = ConfigDict(
        allow_inf_nan=False,
        json_schema_extra={"example": {"fit": _ID, "simulations": 100, "time_limit_seconds": 300}},
    )

    fit: str = Field(max_length=64, description="id of the fit")
    simulations: Annotated[int, Field(ge=1, le=10_000)] = 200


class TradeoffRequest(TradeoffSpec):
    """What to measure on a table: see ``TradeoffSpec``. Models are short names or specifications."""

    model_config = ConfigDict(
        allow_inf_nan=False,
        json_schema_extra={
            "example": {"table": _ID, "models": ["ward"], "time_limit_seconds": 30, "posterior": False}
        },
    )

    table: str = Field(max_length=64, description="id of the table")
    models: Annotated[list[ModelSpec | Label], Field(min_length=1, max_length=16)]  # pyright: ignore[reportIncompatibleVariableOverride, reportGeneralTypeIssues]
    time_limit_seconds: Annotated[float, Field(gt=0, le=3600)] = 60.0


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


class PlanRequest(_Request):
    """A scene, and what its plan may change: `tolerance` is the scene's own where it is left out."""

    model_config = ConfigDict(json_schema_extra={"example": {"scene": _SCENE, "tolerance": 0.01}})

    scene: SceneDocument
    tolerance: Annotated[float, Field(gt=0, lt=1)] | None = None
    seed: Seed = 0


class RenderRequest(_Request):
    """A scene to render. With `plan` effects that its tolerance allows are left out."""

    model_config = ConfigDict(json_schema_extra={"example": {"scene": _SCENE, "samples": 4, "seed": 1}})

    scene: SceneDocument
    samples: Annotated[int, Field(ge=1, le=1_000_000)] | None = Field(None, description="a pixel")
    seconds: Annotated[float, Field(gt=0, le=3600)] = 60.0
    target_error: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        None, description="root mean square of the standard errors over F"
    )
    seed: Seed = 0
    precision: Literal["float32", "float64"] = "float32"
    plan: bool = False
    layers: bool = Field(False, description="one layer in the OpenEXR file for each effect")


class PlanDocument(BaseModel):
    """A plan, as ``brdf-fitter scene plan --json`` prints it."""

    model_config = ConfigDict(extra="allow")

    kind: Literal["brdf-fitter/plan"]
    tolerance: float
    bound: float = Field(description="of the error of all that is left out together")
    reference: float = Field(description="F: errors are relative to max(L, 0.01 F)")
    decisions: list[dict[str, Any]]
    operations: dict[str, float]


class SceneSummary(BaseModel):
    """One rendered scene in a list."""

    id: str = Field(examples=[_ID])
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


class Progress(BaseModel):
    """How far a job is: share in [0, 1], and what it is doing."""

    share: float
    what: str


class JobDocument(BaseModel):
    """Work that takes time. ``results`` link what it made, or hold the problem of a model that failed, or the
    comparison that "auto" made."""

    id: str = Field(examples=[_ID])
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


class FitSummary(BaseModel):
    """One fit in a list."""

    id: str = Field(examples=[_ID])
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

    id: str = Field(examples=[_ID])
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

    id: str = Field(examples=[_ID])
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


class ModelRequest(_Request):
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

    id: str = Field(examples=[_ID])
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
