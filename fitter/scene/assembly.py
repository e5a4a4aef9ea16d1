"""Scene: a specification with everything it names found, read and checked."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fitter.errors import SpecError
from fitter.models import ReflectanceModel, create
from fitter.scene import shapes
from fitter.scene.lights import Lamp, lamp
from fitter.scene.materials import Material, ModelMaterial, TableMaterial
from fitter.scene.shapes import Geometry
from fitter.scene.spec import Material as MaterialSpec
from fitter.scene.spec import SceneSpec, scene_spec
from fitter.table import Table

#: What finds the model or table of a material that is not given inline.
Finder = Callable[[MaterialSpec], ReflectanceModel | Table]


@dataclass(frozen=True)
class Scene:
    """A scene ready to be planned and rendered; ``of_shape[k]`` is the index of shape k's material.
    ``stand_ins[m]`` : what a plan may use in place of material m, with the names of their sources."""

    spec: SceneSpec
    geometry: Geometry
    lamps: tuple[Lamp, ...]
    names: tuple[str, ...]
    materials: tuple[Material, ...]
    of_shape: np.ndarray
    stand_ins: tuple[tuple[tuple[str, Material], ...], ...]


def load_scene(path: str | Path) -> Scene:
    """The scene in a TOML or JSON file; paths in it start from its folder. Raises SpecError, TableError."""
    file = Path(path)
    return scene(read_document(file), folder=file.parent, find=_files(file.parent))


def read_document(path: Path) -> Mapping[str, Any]:
    """The document in a TOML or JSON file, by its first character. Raises SpecError naming the row."""
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise SpecError(
            f"the scene can't be read: {getattr(error, 'strerror', None) or error}", code="scene-unreadable",
            file=str(path), remedy="give the path of a TOML or JSON file",
        ) from error  # fmt: skip
    try:
        found: Any = json.loads(text) if text.lstrip().startswith("{") else tomllib.loads(text)
    except json.JSONDecodeError as error:
        raise SpecError(
            f"is not JSON: {error.msg}", code="bad-scene", file=str(path), row=error.lineno
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise SpecError(f"is not TOML: {error}", code="bad-scene", file=str(path)) from error
    return found


def scene(
    document: Mapping[str, Any] | SceneSpec, *, folder: Path | None = None, find: Finder | None = None
) -> Scene:
    """A scene from a specification. ``folder`` is where paths start; without one the scene names no files.

    find : the model or table of a material that names one (files and, over HTTP, ids).

    Raises SpecError, TableError: whatever of it is missing, damaged, or makes no sense.
    """
    spec = scene_spec(document)
    geometry = shapes.geometry(spec, folder)
    shapes.check_camera(spec, geometry)
    lamps = tuple(lamp(one, spec.channels, folder, k) for k, one in enumerate(spec.lights))
    names = tuple(spec.materials)
    made = tuple(material(spec.materials[name].rendered, spec.channels, name, find) for name in names)
    stand_ins = tuple(
        tuple(
            (str(one.fit or one.compressed), material(one, spec.channels, name, find))
            for one in spec.materials[name].stand_ins
        )
        for name in names
    )
    of_shape = np.array([names.index(shape.material) for shape in spec.shapes], np.int32)
    return Scene(spec, geometry, lamps, names, made, of_shape, stand_ins)


def material(one: MaterialSpec, channels: tuple[str, ...], name: str, find: Finder | None) -> Material:
    """The material ``name`` with the scene's channels, or with one that serves all of them."""
    where = f"materials.{name}"
    if one.model is not None:
        try:
            given: dict[str, Any] = {key: np.asarray(value) for key, value in one.values.items()}
            found: ReflectanceModel | Table = create(one.model, **given)
        except SpecError as error:
            error.parameter = f"{where}.{error.parameter or 'model'}"
            raise
    elif find is None:
        raise SpecError(
            "a material can't name a file here", code="no-files", parameter=where,
            remedy="give a model with values",
        )  # fmt: skip
    else:
        found = find(one)
    return made_of(found, channels, name)


def made_of(found: ReflectanceModel | Table, channels: tuple[str, ...], name: str) -> Material:
    """A material of a model or a table, with the scene's channels. Raises SpecError where they don't fit."""
    where = f"materials.{name}"
    if isinstance(found, Table):
        return TableMaterial(found, _columns([c.name for c in found.channels], channels, where))
    return ModelMaterial(chosen(found, _columns(list(found.channels), channels, where)))


def _columns(there: list[str], channels: tuple[str, ...], where: str) -> np.ndarray:
    """The material's channels that serve the scene's: by name, or its only one."""
    if set(channels) <= set(there):
        return np.array([there.index(name) for name in channels])
    if len(there) == 1:
        return np.array([0])
    raise SpecError(
        f"the material has the channels {', '.join(there)}, and the scene has {', '.join(channels)}",
        code="channels-differ", parameter=where, remedy="name the scene's channels as the material's",
    )  # fmt: skip


def chosen(model: ReflectanceModel, columns: np.ndarray) -> ReflectanceModel:
    """The model with these of its channels."""
    if len(columns) == len(model.channels) and (columns == np.arange(len(columns))).all():
        return model
    per_channel = {
        name: np.asarray(value)[columns] if np.ndim(value) else np.asarray(value)
        for name, value in model.values.items()
    }
    return create(model.spec, channels=[model.channels[k] for k in columns], **per_channel)


def _files(folder: Path) -> Finder:
    def find(one: MaterialSpec) -> ReflectanceModel | Table:
        if one.fit is not None:
            from fitter.fitting import load_fit

            return load_fit(folder / one.fit).model
        from fitter.formats import load

        return load(folder / str(one.table or one.compressed), **dict(one.options))

    return find
