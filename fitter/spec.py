"""ModelSpec, FitSpec, PosteriorSpec: what is asked for; shared by Python, the command line and HTTP."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from fitter.errors import SpecError

Family = Literal["ward", "torrance_sparrow", "lafortune", "oren_nayar"]
FAMILIES: tuple[Family, ...] = ("ward", "torrance_sparrow", "lafortune", "oren_nayar")
Metric = Literal["measurement", "absolute", "cosine", "log", "cbrt"]
Solver = Literal["optimistix", "nlopt"]

#: What each family understands, default first. One place: parsing, documentation and errors read it.
OPTIONS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "ward": {"variant": ("ward1992", "duer", "bounded")},
    "torrance_sparrow": {
        "ndf": ("beckmann", "ggx"),
        "masking": ("v_groove", "smith"),
        "fresnel": ("schlick", "none"),
    },
    "lafortune": {},
    "oren_nayar": {"variant": ("qualitative",)},
}
MAX_LOBES: Mapping[str, int] = {"lafortune": 3}


_T = TypeVar("_T", bound=BaseModel)


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    def __hash__(self) -> int:
        # Mappings inside are not hashable; the canonical JSON is, and it is what results are keyed by.
        return hash((type(self).__name__, self.model_dump_json()))


class ModelSpec(_Frozen):
    """Which reflectance model exactly.

    ``per_channel`` names the nonlinear parameters that each channel has for itself; None takes the
    model's default. Linear parameters (kd, ks, ...) are always per channel.
    """

    family: Family
    variant: str | None = None
    ndf: str | None = None
    masking: str | None = None
    fresnel: str | None = None
    lobes: Annotated[int, Field(ge=1, le=3)] = 1
    diffuse: Literal["lambert", "none"] = "lambert"
    per_channel: tuple[str, ...] | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        options = OPTIONS[self.family]
        for name in ("variant", "ndf", "masking", "fresnel"):
            given = getattr(self, name)
            allowed = options.get(name)
            if allowed is None:
                if given is not None:
                    raise ValueError(f"{self.family} has no option {name}")
            elif given is None:
                object.__setattr__(self, name, allowed[0])
            elif given not in allowed:
                raise ValueError(f"{name} of {self.family} is one of {', '.join(allowed)}, not {given!r}")
        most = MAX_LOBES.get(self.family, 1)
        if self.lobes > most:
            raise ValueError(f"{self.family} has at most {most} lobe(s), not {self.lobes}")
        if self.family == "oren_nayar" and self.diffuse != "lambert":
            raise ValueError("oren_nayar is itself the diffuse term: it can't be without")
        return self

    @classmethod
    def parse(cls, short: str) -> ModelSpec:
        """From a short name: ``family[:option]...``, as "ward:bounded", "torrance_sparrow:ggx:smith",
        "lafortune:2" (lobes) or "lafortune:2:no_diffuse". Options may come in any order."""
        family, *words = short.strip().lower().replace("-", "_").split(":")
        if family not in OPTIONS:
            raise SpecError(
                f"there is no model {family!r}", code="unknown-model", parameter="model",
                remedy=f"use one of {', '.join(FAMILIES)}",
            )  # fmt: skip
        chosen: dict[str, Any] = {"family": family}
        for word in words:
            if word.isascii() and word.isdecimal():
                chosen["lobes"] = int(word)
            elif word == "no_diffuse":
                chosen["diffuse"] = "none"
            else:
                for name, allowed in OPTIONS[family].items():
                    if word in allowed:
                        chosen[name] = word
                        break
                else:
                    known = [item for allowed in OPTIONS[family].values() for item in allowed]
                    raise SpecError(
                        f"{family} has no option {word!r}", code="unknown-model", parameter="model",
                        remedy=f"options are {', '.join([*known, 'a number of lobes', 'no_diffuse'])}",
                    )  # fmt: skip
        return _validated(cls, chosen)

    @property
    def name(self) -> str:
        """The short name that :meth:`parse` reads back, default options left out."""
        words: list[str] = [self.family]
        for option, allowed in OPTIONS[self.family].items():
            chosen = getattr(self, option)
            if chosen != allowed[0]:
                words.append(chosen)
        if self.lobes > 1:
            words.append(str(self.lobes))
        if self.diffuse == "none":
            words.append("no_diffuse")
        return ":".join(words)


class Select(_Frozen):
    """Which samples and channels of a table are fitted. Angles in degrees; None means all."""

    theta_i_max_deg: Annotated[float, Field(gt=0, le=90)] | None = None
    theta_o_max_deg: Annotated[float, Field(gt=0, le=90)] | None = None
    channels: Annotated[tuple[str, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if self.channels is not None and len(set(self.channels)) < len(self.channels):
            raise ValueError("a channel is named twice")
        return self


class FitSpec(_Frozen):
    """One fit. Separate from the table and stored with every result, so that it can be made again.

    ``metric`` None takes "measurement" where the table states sigma, else "cbrt". ``fixed`` holds
    nonlinear parameters at a value, ``bounds`` narrows their range.
    """

    model: ModelSpec
    metric: Metric | None = None
    solver: Solver = "optimistix"
    fixed: Mapping[str, float] = Field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = Field(default_factory=dict)
    select: Select = Select()
    starts: Annotated[int, Field(ge=1, le=1000)] | None = None
    subset: Annotated[int, Field(ge=64, le=1_000_000)] = 4096
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0


class PosteriorSpec(_Frozen):
    """How a posterior is sampled. ``budget_seconds`` ends a run that has not reached its targets.

    ``noise`` "table" takes the table's sigma as it is; "inferred" adds a relative noise and an additive
    floor as parameters; None takes "table" where sigma is stated, else "inferred".
    """

    noise: Literal["table", "inferred"] | None = None
    ensembles: Annotated[int, Field(ge=2, le=32)] = 4
    walkers: Annotated[int, Field(ge=8, le=1024)] | None = None
    rhat: Annotated[float, Field(gt=1.0, le=1.2)] = 1.01
    ess: Annotated[int, Field(ge=50, le=1_000_000)] = 1000
    budget_seconds: Annotated[float, Field(gt=0, le=86_400)] = 60.0
    max_samples: Annotated[int, Field(ge=50, le=10_000_000)] = 20_000
    keep: Annotated[int, Field(ge=100, le=1_000_000)] = 4000
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0


def model_spec(given: ModelSpec | str | Mapping[str, Any]) -> ModelSpec:
    """A ModelSpec from itself, a short name or a mapping. Raises SpecError with the remedy."""
    if isinstance(given, ModelSpec):
        return given
    if isinstance(given, str):
        return ModelSpec.parse(given)
    return _validated(ModelSpec, dict(given))


def fit_spec(given: Mapping[str, Any]) -> FitSpec:
    """A FitSpec from a JSON-like mapping whose model may be a short name. Raises SpecError."""
    document = dict(given)
    if isinstance(document.get("model"), str):
        document["model"] = ModelSpec.parse(document["model"])
    return _validated(FitSpec, document)


def posterior_spec(given: Mapping[str, Any]) -> PosteriorSpec:
    """A PosteriorSpec from a JSON-like mapping. Raises SpecError."""
    return _validated(PosteriorSpec, dict(given))


def _validated(kind: type[_T], document: Mapping[str, Any]) -> _T:
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or None
        raise SpecError(
            first["msg"].removeprefix("Value error, "), code="bad-spec", parameter=where,
            remedy=f"see the fields of {kind.__name__}: {', '.join(kind.model_fields)}",
        ) from error  # fmt: skip


def canonical_json(spec: BaseModel) -> str:
    """One spelling per specification: sorted keys, no spaces."""
    return json.dumps(spec.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
