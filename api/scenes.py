"""Scenes over HTTP: materials are named by the ids of models and tables; files are not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from api.problems import Problem
from api.rows import ModelRow, Row, TableRow
from api.tables import OpenTables
from fitter.errors import SpecError

if TYPE_CHECKING:
    import fitter
    from fitter.models import ReflectanceModel
    from fitter.scene import Scene
    from fitter.scene.spec import Material


_R = TypeVar("_R", bound=Row)


class Find(Protocol):
    """The row of an id, None where there is none or it may not be seen."""

    def __call__(self, kind: type[_R], id: str, /) -> _R | None: ...


def scene_of(document: Mapping[str, Any], row: Find, tables: OpenTables) -> Scene:
    """The scene of a request. Raises SpecError, or Problem (404) where an id names nothing."""
    from fitter.models import from_dict
    from fitter.scene import scene

    def find(one: Material) -> ReflectanceModel | fitter.Table:
        if one.fit is not None:
            model = row(ModelRow, one.fit)
            if model is None:
                raise Problem.not_found("model", one.fit)
            return from_dict(model.document)
        if one.table is not None and not one.options:
            table = row(TableRow, one.table)
            if table is None:
                raise Problem.not_found("table", one.table)
            return tables.open(table).table
        raise SpecError(
            "a material is the id of a table or of a model, or a model with values", code="no-files",
            parameter="materials", remedy="upload the table with its reading options, and give its id",
        )  # fmt: skip

    return scene(document, find=find)
