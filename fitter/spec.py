"""ModelSpec, FitSpec and the like: what is asked for; shared by Python, the command line and HTTP."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, Field, model_validator

from fitter.model_spec import CANON, FAMILIES, OPTIONS, Frozen, ModelSpec, Options, model_spec, validated

__all__ = [
    "AUTO", "CANON", "FAMILIES", "OPTIONS", "Angles", "CalibrationSpec", "Draws", "FitSettings", "FitSpec",
    "Likelihood", "Metric", "ModelSpec", "NoiseModel", "Options", "Polish", "PosteriorSpec", "Select",
    "SelectionSpec", "Solver", "TradeoffSpec", "Weighting", "calibration_spec", "canonical_json",
    "fit_spec", "model_spec", "posterior_spec", "selection_spec", "tradeoff_spec",
]  # fmt: skip

Metric = Literal["measurement", "absolute", "cosine", "relative", "log", "cbrt"]
Weighting = Literal["samples", "solid_angle"]
Solver = Literal["optimistix", "nlopt"]
#: In the place of a model: compare models and take the one that the table supports.
AUTO = "auto"
#: "full" ends with passes over the whole table, "subset" never looks beyond the weighted subset.
Polish = Literal["full", "subset"]
NoiseModel = Literal["table", "inferred"]
Likelihood = Literal["gaussian", "student_t"]
Draws = Literal["posterior", "robust"]
Angles = Literal["exact", "offset"]
Starts = Annotated[int, Field(ge=1, le=1000)]
SubsetSize = Annotated[int, Field(ge=64, le=1_000_000)]
Tolerance = Annotated[float, Field(ge=0, lt=1)]


class Select(Frozen):
    """Which samples and channels of a table are fitted. Angles in degrees; None means all."""

    theta_i_max_deg: Annotated[float, Field(gt=0, le=90)] | None = None
    theta_o_max_deg: Annotated[float, Field(gt=0, le=90)] | None = None
    channels: Annotated[tuple[str, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if self.channels is not None and len(set(self.channels)) < len(self.channels):
            raise ValueError("a channel is named twice")
        return self


class FitSettings(Frozen):
    """How to fit, whatever the model.

    ``metric`` None takes "measurement" where the table states sigma, else "cbrt". ``weighting`` says whether
    every sample counts alike or by the solid angles that it stands for; None takes "solid_angle" for tables
    on a grid, but for "measurement" and "absolute".

    ``budget_seconds`` or ``target_error`` leave the effort (``subset``, ``polish``, and ``starts`` where it
    is None) to :mod:`fitter.fitting.budget`; the result's specification is the one that was chosen.
    """

    metric: Metric | None = None
    weighting: Weighting | None = None
    select: Select = Select()
    starts: Starts | None = None
    subset: SubsetSize = 4096
    polish: Polish = "full"
    budget_seconds: Annotated[float, Field(gt=0, le=86_400)] | None = None
    target_error: Annotated[float, Field(gt=0, lt=1)] | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0


class FitSpec(FitSettings):
    """One fit. Separate from the table and stored with every result, so that it can be made again.

    ``fixed`` holds nonlinear parameters at a value, ``bounds`` narrows their range.
    """

    model: ModelSpec
    solver: Solver = "optimistix"
    fixed: Mapping[str, float] = Field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = Field(default_factory=dict)


class TradeoffSpec(Frozen):
    """What a tradeoff measures: see :mod:`fitter.tradeoffs.design`.

    ``models`` : the first gets the whole design, the others their default, cheap and reference fits.
    ``metrics``, ``solvers``, ``subsets``, ``starts``, ``tolerances`` : further values of each axis; None
    takes the usual ones, an empty tuple leaves the axis out. ``time_limit_seconds`` ends the measuring
    between two fits; what was not reached is listed.
    """

    models: Annotated[tuple[ModelSpec, ...], Field(min_length=1, max_length=16)]
    metric: Metric | None = None
    metrics: Annotated[tuple[Metric, ...], Field(max_length=8)] | None = None
    solvers: Annotated[tuple[Solver, ...], Field(max_length=4)] | None = None
    subsets: Annotated[tuple[SubsetSize, ...], Field(max_length=16)] | None = None
    starts: Annotated[tuple[Starts, ...], Field(max_length=16)] | None = None
    tolerances: Annotated[tuple[Tolerance, ...], Field(max_length=16)] | None = None
    posterior: bool = True
    select: Select = Select()
    repeats: Annotated[int, Field(ge=1, le=100)] = 5
    time_limit_seconds: Annotated[float, Field(gt=0, le=86_400)] = 60.0
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0


class SelectionSpec(Frozen):
    """A comparison of models. What it has in common with FitSpec holds for every fit in it.

    ``candidates`` None takes the families and their nested forms, as far as the table supports them.
    ``budget_seconds`` ends the list of candidates early; without it the result depends on no clock.
    """

    candidates: Annotated[tuple[ModelSpec, ...], Field(min_length=1, max_length=32)] | None = None
    metric: Metric | None = None
    solver: Solver = "optimistix"
    select: Select = Select()
    starts: Annotated[int, Field(ge=1, le=1000)] | None = None
    subset: Annotated[int, Field(ge=64, le=1_000_000)] = 4096
    folds: Annotated[int, Field(ge=3, le=20)] = 5
    budget_seconds: Annotated[float, Field(gt=0, le=86_400)] | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        names = [model.name for model in self.candidates or ()]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"{', '.join(twice)} is a candidate twice")
        return self


class PosteriorSpec(Frozen):
    """How a posterior is sampled. ``budget_seconds`` ends a run that has not reached its targets.

    ``noise`` "table" takes the table's sigma as it is; "inferred" adds a relative noise and an additive
    floor as parameters; None takes "table" where sigma is stated, else "inferred".
    ``likelihood`` "student_t" has the same scales and heavier tails. Its ``degrees_of_freedom`` are given,
    not inferred: they and an inferred scale say nearly the same of the data, and few tables can tell them
    apart. ``angles`` "offset" gives each of the instrument's angles an offset that is sampled, with a normal
    prior as wide as ``angle_uncertainty_deg``, or as the table states where that is None; given, it asks for
    offsets by itself. "exact" is the default since offsets of a model that misfits go where the misfit is.
    ``draws`` "robust" rescales the draws to the uncertainty that holds where the residuals of a scan belong
    together (:mod:`fitter.posterior.jackknife`).
    """

    noise: NoiseModel | None = None
    likelihood: Likelihood = "gaussian"
    degrees_of_freedom: Annotated[float, Field(ge=1, le=100)] = 4.0
    angles: Angles = "exact"
    angle_uncertainty_deg: Annotated[float, Field(ge=0, le=5)] | None = None
    draws: Draws = "posterior"
    ensembles: Annotated[int, Field(ge=2, le=32)] = 4
    walkers: Annotated[int, Field(ge=8, le=1024)] | None = None
    rhat: Annotated[float, Field(gt=1.0, le=1.2)] = 1.01
    ess: Annotated[int, Field(ge=50, le=1_000_000)] = 1000
    budget_seconds: Annotated[float, Field(gt=0, le=86_400)] = 60.0
    max_samples: Annotated[int, Field(ge=50, le=10_000_000)] = 20_000
    keep: Annotated[int, Field(ge=100, le=1_000_000)] = 4000
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0


class CalibrationSpec(Frozen):
    """Simulations that a posterior of a model is judged by: see :mod:`fitter.calibration`.

    ``around`` : truths lie within so many standard uncertainties of the fit; None takes the whole prior.
    ``ranges`` : of truths, by name or label, instead. ``noise`` as for a posterior: the table's sigma, or a
    relative noise and a floor that are drawn from their ``ranges`` and inferred.
    ``draws`` : of each posterior, among which the truth has its rank. ``level`` : of the intervals whose
    coverage is counted. ``confidence`` : with which a posterior without fault passes all tests together.
    ``time_limit_seconds`` ends the work between two simulations.
    """

    simulations: Annotated[int, Field(ge=1, le=100_000)] = 200
    around: Annotated[float, Field(gt=0, le=1000)] | None = 5.0
    ranges: Mapping[str, tuple[float, float]] = Field(default_factory=dict)
    noise: Literal["table", "inferred"] | None = None
    draws: Annotated[int, Field(ge=19, le=9_999)] = 99
    level: Annotated[float, Field(gt=0, lt=1)] = 0.95
    confidence: Annotated[float, Field(gt=0.5, lt=1)] = 0.99
    posterior: PosteriorSpec = PosteriorSpec(
        ensembles=2, rhat=1.05, ess=400, keep=1000, max_samples=2000, budget_seconds=60.0
    )
    time_limit_seconds: Annotated[float, Field(gt=0, le=604_800)] | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0


def fit_spec(given: Mapping[str, Any]) -> FitSpec:
    """A FitSpec from a JSON-like mapping whose model may be a short name. Raises SpecError."""
    document = dict(given)
    if isinstance(document.get("model"), str):
        document["model"] = ModelSpec.parse(document["model"])
    return validated(FitSpec, document)


def selection_spec(given: Mapping[str, Any]) -> SelectionSpec:
    """A SelectionSpec from a JSON-like mapping whose candidates may be short names. Raises SpecError."""
    document = dict(given)
    if document.get("candidates") is not None:
        document["candidates"] = tuple(model_spec(one) for one in document["candidates"])
    return validated(SelectionSpec, document)


def tradeoff_spec(given: Mapping[str, Any]) -> TradeoffSpec:
    """A TradeoffSpec from a JSON-like mapping whose models may be short names. Raises SpecError."""
    document = dict(given)
    models: Any = document.get("models")
    if isinstance(models, list | tuple):
        document["models"] = [ModelSpec.parse(one) if isinstance(one, str) else one for one in models]  # pyright: ignore[reportUnknownVariableType]
    return validated(TradeoffSpec, document)


def posterior_spec(given: Mapping[str, Any]) -> PosteriorSpec:
    """A PosteriorSpec from a JSON-like mapping. Raises SpecError."""
    return validated(PosteriorSpec, dict(given))


def calibration_spec(given: Mapping[str, Any]) -> CalibrationSpec:
    """A CalibrationSpec from a JSON-like mapping; what its posterior leaves out keeps the calibration's
    default. Raises SpecError."""
    document = dict(given)
    posterior: Any = document.get("posterior")
    if isinstance(posterior, Mapping):
        usual = CalibrationSpec.model_fields["posterior"].default.model_dump()
        document["posterior"] = {**usual, **posterior}
    return validated(CalibrationSpec, document)


def canonical_json(spec: BaseModel) -> str:
    """One spelling per specification: sorted keys, no spaces."""
    return json.dumps(spec.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
