"""Records of what has become of units: a unit whose record is there has ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fitter.batch.planning import TABLES, Unit
from fitter.documents import read_document, write_document
from fitter.errors import SpecError

#: The record of a finished unit, in its folder.
RECORD = "unit.json"
#: That of one of a unit's several tables.
TABLE = "table.json"
KIND = "brdf-fitter/batch-unit"


def record_of(
    unit: Unit, key: str, seconds: float | None = None, tables: Sequence[Mapping[str, Any]] = (),
    error: Mapping[str, Any] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """What has become of a unit."""
    return {
        "kind": KIND, "key": key, "unit": unit.to_dict(), "seconds": seconds, "tables": list(tables),
        "error": error,
    }  # fmt: skip


def write_record(out: Path, record: Mapping[str, Any]) -> None:
    """Write the record into its unit's folder: the unit has ended."""
    write_document(record, out / TABLES / record["unit"]["name"] / RECORD)


def failed(record: Mapping[str, Any]) -> bool:
    """Whether the unit, or all models of one of its tables, failed."""
    return record["error"] is not None or any("best" not in table for table in record["tables"])


def read_record(out: Path, name: str) -> dict[str, Any] | None:
    """The record of the unit of that name; None where there is none that can be read."""
    record = _read(out / TABLES / name / RECORD)
    return record if record.get("kind") == KIND else None


def known(place: Path, key: str) -> dict[str, Any] | None:
    """One of a unit's several tables, where it was done as asked now before the unit was stopped."""
    document = _read(place / TABLE)
    table = document.get("table")
    return table if document.get("key") == key and isinstance(table, dict) and "best" in table else None


def _read(path: Path) -> dict[str, Any]:
    """What the file holds; nothing where it can't be read: then it is done again, which mends it."""
    try:
        return dict(read_document(path, "not-a-batch")) if path.exists() else {}
    except SpecError:
        return {}
