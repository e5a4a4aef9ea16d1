"""BatchSpec: which tables, which models, what to write; from Python, from a YAML or a TOML file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from fitter.errors import SpecError
from fitter.formats.read_options import read_options
from fitter.model_spec import FAMILIES, ModelSpec, model_spec, validated
from fitter.spec import AUTO, FitSettings, FitSpec, PosteriorSpec

#: What the name of a service's table begins with; its id follows.
SERVER = "server:"


class BatchSpec(FitSettings):
    """Many fits. Paths are taken from the folder of the file that the specification stands in.

    tables : files, folders (their visible files), zip archives, and patterns with ``*``, ``?``, ``[...]``
        and ``**``; ``server:ID`` is a table of the service that ``--server`` names.
    manifest : a CSV file with a column ``path`` and, where wanted, ``name`` (of the output folder) and any
        reading option, for tables that differ in these.
    reading : options of :func:`fitter.load` for all tables.
    models : what is fitted to each, or "auto": compare models and take the best.
    posterior : how to sample the best fit's posterior; None leaves it out.
    report : whether to write a report about the best fit.
    exports : targets (:mod:`fitter.export`) to write it to, too.

    The others are those of :class:`fitter.spec.FitSettings`, for each fit.
    """

    tables: tuple[str, ...] = ()
    manifest: str | None = None
    reading: Mapping[str, Any] = Field(default_factory=dict)
    models: Annotated[tuple[ModelSpec, ...], Field(min_length=1, max_length=32)] | Literal["auto"]
    posterior: PosteriorSpec | None = None
    report: bool = True
    exports: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        if not self.tables and self.manifest is None:
            raise ValueError("name tables or a manifest")
        if self.models != AUTO:
            names = [model.name for model in self.models]
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"{', '.join(twice)} is named twice")
        return self

    def fit_spec(self, model: ModelSpec) -> FitSpec:
        """What is asked of one fit."""
        return FitSpec(model=model, **{name: getattr(self, name) for name in FitSettings.model_fields})


def batch_spec(given: Mapping[str, Any]) -> BatchSpec:
    """A BatchSpec from a JSON-like mapping whose models may be short names. Raises SpecError."""
    document = dict(given)
    models: Any = document.get("models", FAMILIES)
    if models != AUTO:
        listed = [models] if isinstance(models, str) else models
        if not isinstance(listed, list | tuple):
            raise SpecError(
                "models is no list of names", code="bad-spec", parameter="models",
                remedy='give ["ward", "lafortune:2"] or "auto"',
            )  # fmt: skip
        models = tuple(model_spec(one) for one in listed)  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
    found = validated(BatchSpec, {**document, "models": models})
    read_options(dict(found.reading))
    _check_exports(found.exports)
    return found


def schema() -> dict[str, Any]:
    """The JSON schema of a specification as people write it: models by their short names, too."""
    found = BatchSpec.model_json_schema()
    models = found["properties"]["models"]
    listed = next(one for one in models["anyOf"] if one.get("type") == "array")
    listed["items"] = {"anyOf": [{"type": "string"}, listed["items"]]}
    models["default"] = list(FAMILIES)
    found["required"] = [name for name in found.get("required", []) if name != "models"]
    return found


def read_spec(path: str | Path) -> BatchSpec:
    """The specification in a YAML (``.yaml``, ``.yml``) or TOML file; its paths become absolute.

    Raises SpecError naming the file, and the line where it is no YAML or TOML.
    """
    import yaml

    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        document: Any = tomllib.loads(text) if path.suffix == ".toml" else yaml.safe_load(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, yaml.YAMLError) as error:
        raise SpecError(
            f"the batch specification can't be read: {' '.join(str(error).split())}", code="bad-spec",
            file=str(path), remedy="see docs/batch.md for an example",
        ) from error  # fmt: skip
    if not isinstance(document, Mapping):
        raise SpecError(
            "the batch specification is no mapping of names to values", code="bad-spec", file=str(path),
            remedy="see docs/batch.md for an example",
        )  # fmt: skip
    try:
        found = batch_spec(document)  # pyright: ignore[reportUnknownArgumentType]
    except SpecError as error:
        error.file = error.file or str(path)
        raise
    folder = path.resolve().parent
    return found.model_copy(
        update={
            "tables": tuple(one if one.startswith(SERVER) else str(folder / one) for one in found.tables),
            "manifest": None if found.manifest is None else str(folder / found.manifest),
        }
    )


def _check_exports(names: tuple[str, ...]) -> None:
    from fitter.export import target

    for name in names:
        if not target(name).models:
            raise SpecError(
                f"{name} takes no model", code="unknown-export", parameter="exports",
                remedy="see `brdf-fitter export --help`",
            )  # fmt: skip
