"""ModelSpec: which reflectance model exactly, and what every family of models can be asked for."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from fitter.errors import SpecError

_T = TypeVar("_T", bound=BaseModel)


class Frozen(BaseModel):
    """A specification: immutable, hashable, no unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def __hash__(self) -> int:
        # Mappings inside are not hashable; the canonical JSON is, and it is what results are keyed by.
        return hash((type(self).__name__, self.model_dump_json()))


@dataclass(frozen=True)
class Options:
    """What a family understands, the default of every choice first.

    parts : prefixes of the components' parameters; a family with parts is built of other models.
    fewest : how many components it needs at least; all of ``parts`` where None.
    """

    choices: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    diffuse: tuple[str, ...] = ()
    anisotropic: bool = False
    max_lobes: int = 1
    parts: tuple[str, ...] = ()
    fewest: int | None = None


#: Components inside components, at most: each level is a model to be built and compiled.
MAX_DEPTH = 4

_MICROFACETS = {"ndf": ("ggx", "beckmann"), "masking": ("smith", "smith_separable")}
_ADDITIVE = ("lambert", "none")

#: The families that are fitted by default.
FAMILIES: tuple[str, ...] = ("ward", "torrance_sparrow", "lafortune", "oren_nayar")

#: One place: parsing, documentation, tests and errors read it.
OPTIONS: Mapping[str, Options] = {
    "ward": Options({"variant": ("ward1992", "duer", "bounded")}, _ADDITIVE, anisotropic=True),
    "torrance_sparrow": Options(
        {
            "ndf": ("beckmann", "ggx", "blinn", "gaussian"),
            "masking": ("v_groove", "smith", "smith_separable", "schlick_ggx", "rational"),
            "fresnel": ("schlick", "none", "dielectric", "conductor"),
        },
        ("lambert", "none", "coupled"),
        anisotropic=True,
    ),
    "lafortune": Options({}, _ADDITIVE, anisotropic=True, max_lobes=3),
    "oren_nayar": Options({"variant": ("qualitative", "full", "fujii", "eon")}, ("lambert",)),
    "lambert": Options(),
    "phong": Options({}, _ADDITIVE),
    "blinn_phong": Options({}, _ADDITIVE),
    "cook_torrance": Options(
        {"ndf": ("beckmann", "ggx"), "fresnel": ("dielectric", "conductor", "schlick")}, _ADDITIVE
    ),
    "ashikhmin_shirley": Options(),
    "specular": Options({"fresnel": ("none", "schlick", "dielectric", "conductor")}),
    "smooth_dielectric": Options(),
    "rough_dielectric": Options(_MICROFACETS, anisotropic=True),
    "layered": Options({"ndf": ("ggx", "beckmann")}, parts=("base_",)),
    "metallic_roughness": Options(),
    "kulla_conty": Options({"ndf": ("ggx", "beckmann"), "fresnel": ("schlick", "none")}),
    "rough_facets": Options({"ndf": ("ggx", "beckmann")}, parts=("facet_",)),
    "he_torrance": Options(),
    "sum": Options(parts=("a_", "b_", "c_", "d_", "e_", "f_"), fewest=2),
}  # fmt: skip

#: The rest of the lecture canon: evaluated, sampled and integrated; fitted only where separable.
CANON: tuple[str, ...] = tuple(family for family in OPTIONS if family not in FAMILIES)

#: Choices that exclude each other: (option, value, other option, values it needs, why).
_NEEDS: tuple[tuple[str, str, str, tuple[Any, ...], str], ...] = (
    ("ndf", "blinn", "anisotropic", (False,), "its anisotropic form is ashikhmin_shirley"),
    ("ndf", "gaussian", "anisotropic", (False,), "it is a function of theta_h alone"),
    ("masking", "schlick_ggx", "ndf", ("ggx",), "it approximates Smith's term of GGX"),
    ("masking", "schlick_ggx", "anisotropic", (False,), "it knows one roughness"),
    ("masking", "rational", "ndf", ("beckmann",), "it approximates Smith's term of Beckmann"),
    ("diffuse", "coupled", "fresnel", ("schlick", "dielectric", "conductor"), "it is (1 - F) kd/pi"),
)


class ModelSpec(Frozen):
    """Which reflectance model exactly.

    ``per_channel`` names the nonlinear parameters that each channel has for itself; None takes the
    model's default. Linear parameters (kd, ks, ...) are always per channel. ``components`` are the models
    that a composite (sum, layered, rough_facets) is built of.
    """

    family: str
    variant: str | None = None
    ndf: str | None = None
    masking: str | None = None
    fresnel: str | None = None
    anisotropic: bool = False
    lobes: Annotated[int, Field(ge=1, le=3)] = 1
    diffuse: str | None = None
    per_channel: tuple[str, ...] | None = None
    components: tuple[ModelSpec, ...] = ()

    @model_validator(mode="after")
    def _complete(self) -> Self:
        options = OPTIONS.get(self.family)
        if options is None:
            raise ValueError(f"there is no model {self.family!r}: use one of {', '.join(OPTIONS)}")
        choices = {**options.choices, **({"diffuse": options.diffuse} if options.diffuse else {})}
        for name in ("variant", "ndf", "masking", "fresnel", "diffuse"):
            given = getattr(self, name)
            allowed = choices.get(name)
            if allowed is None:
                if given is not None:
                    raise ValueError(f"{self.family} has no option {name}")
            elif given is None:
                object.__setattr__(self, name, allowed[0])
            elif given not in allowed:
                raise ValueError(f"{name} of {self.family} is one of {', '.join(allowed)}, not {given!r}")
        if self.anisotropic and not options.anisotropic:
            raise ValueError(f"{self.family} has no anisotropic form")
        if self.lobes > options.max_lobes:
            raise ValueError(f"{self.family} has at most {options.max_lobes} lobe(s), not {self.lobes}")
        for option, value, other, needed, why in _NEEDS:
            if getattr(self, option) == value and getattr(self, other) not in needed:
                raise ValueError(f"{option} {value} can't go with {other} {getattr(self, other)}: {why}")
        self._check_components(options)
        return self

    @property
    def depth(self) -> int:
        """0 for a model that is built of no other."""
        return 1 + max(part.depth for part in self.components) if self.components else 0

    def _check_components(self, options: Options) -> None:
        if self.depth > MAX_DEPTH:
            raise ValueError(f"components are nested {self.depth} deep, at most {MAX_DEPTH} are allowed")
        most = len(options.parts)
        fewest = most if options.fewest is None else options.fewest
        if not fewest <= len(self.components) <= most:
            wanted = f"{fewest}" if fewest == most else f"{fewest} to {most}"
            raise ValueError(
                f"{self.family} is built of {wanted} other model(s), not {len(self.components)}, "
                f"as {self.family}({', '.join(['lambert'] * max(fewest, 1))})"
                if most
                else f"{self.family} is not built of other models"
            )

    @classmethod
    def parse(cls, short: str) -> ModelSpec:
        """From a short name: ``family[:option]...``, as "ward:bounded", "torrance_sparrow:ggx:smith",
        "ward:anisotropic", "lafortune:2" (lobes) or "lafortune:2:no_diffuse"; options in any order. A
        composite holds its parts in brackets: "sum(ward:no_diffuse, oren_nayar)"."""
        if short.count("(") > len(OPTIONS):
            raise SpecError("too many brackets", code="unknown-model", parameter="model")
        head, parts = _split(short.strip().lower().replace("-", "_"))
        family, *words = head.split(":")
        if family not in OPTIONS:
            raise SpecError(
                f"there is no model {family!r}", code="unknown-model", parameter="model",
                remedy=f"use one of {', '.join(FAMILIES)}; or, to evaluate and sample, {', '.join(CANON)}",
            )  # fmt: skip
        chosen: dict[str, Any] = {"family": family, "components": [cls.parse(part) for part in parts]}
        options = OPTIONS[family]
        for word in words:
            if word.isascii() and word.isdecimal():
                chosen["lobes"] = int(word)
            elif word == "no_diffuse":
                chosen["diffuse"] = "none"
            elif word == "coupled":
                chosen["diffuse"] = "coupled"
            elif word == "anisotropic":
                chosen["anisotropic"] = True
            elif not (name := next((n for n, allowed in options.choices.items() if word in allowed), None)):
                raise SpecError(
                    f"{family} has no option {word!r}", code="unknown-model", parameter="model",
                    remedy=f"options are {', '.join(option_words(family)) or 'none'}",
                )  # fmt: skip
            else:
                chosen[name] = word
        return validated(cls, chosen)

    @property
    def file_name(self) -> str:
        """The file that a result about it is written to: ":" is no character for file names."""
        return f"{self.name.replace(':', '-')}.json"

    @property
    def name(self) -> str:
        """The short name that :meth:`parse` reads back, default options left out."""
        options = OPTIONS[self.family]
        words = [self.family]
        for option, allowed in options.choices.items():
            chosen = getattr(self, option)
            if chosen != allowed[0]:
                words.append(chosen)
        if self.anisotropic:
            words.append("anisotropic")
        if self.lobes > 1:
            words.append(str(self.lobes))
        if options.diffuse and self.diffuse != options.diffuse[0]:
            words.append("no_diffuse" if self.diffuse == "none" else str(self.diffuse))
        parts = f"({', '.join(part.name for part in self.components)})" if self.components else ""
        return ":".join(words) + parts


def option_words(family: str) -> list[str]:
    """Every word that may follow a family in a short name."""
    options = OPTIONS[family]
    words = [word for allowed in options.choices.values() for word in allowed]
    words += ["anisotropic"] if options.anisotropic else []
    words += ["a number of lobes"] if options.max_lobes > 1 else []
    return words + [{"none": "no_diffuse"}.get(word, word) for word in options.diffuse[1:]]


def model_spec(given: ModelSpec | str | Mapping[str, Any]) -> ModelSpec:
    """A ModelSpec from itself, a short name or a mapping. Raises SpecError with the remedy."""
    if isinstance(given, ModelSpec):
        return given
    if isinstance(given, str):
        return ModelSpec.parse(given)
    return validated(ModelSpec, dict(given))


def validated(kind: type[_T], document: Mapping[str, Any]) -> _T:
    """A specification from a JSON-like mapping. Raises SpecError naming the field."""
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or None
        raise SpecError(
            first["msg"].removeprefix("Value error, "), code="bad-spec", parameter=where,
            remedy=f"see the fields of {kind.__name__}: {', '.join(kind.model_fields)}",
        ) from error  # fmt: skip


def _split(short: str) -> tuple[str, list[str]]:
    """The head of a short name and the names between its brackets."""
    found = re.fullmatch(r"([^()]*)(?:\((.*)\))?", short, re.DOTALL)
    if found is None:
        raise SpecError(
            f"the brackets of {short!r} don't match", code="unknown-model", parameter="model",
            remedy="write a composite as sum(ward:no_diffuse, lambert)",
        )  # fmt: skip
    head, inner = found.groups()
    if inner is None:
        return head, []
    parts, depth = [""], 0
    for letter in inner:
        depth += {"(": 1, ")": -1}.get(letter, 0)
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return head, parts
