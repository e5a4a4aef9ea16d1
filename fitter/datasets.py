"""The sample tables and published constants that ship with the product, and the public databases."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fitter.errors import SpecError

if TYPE_CHECKING:
    from fitter.databases import Database, Fetched
    from fitter.progress import Progress

_HERE = Path(__file__).resolve().parent


def samples() -> dict[str, str]:
    """Name -> one-line description of every sample table."""
    return {path.stem: _description(path) for path in _files("tables", "sample table")}


def sample(name: str) -> Path:
    """Path of the sample table ``name``, ready for :func:`fitter.load`.

    Raises SpecError for a name that does not exist, or where the data was not installed.
    """
    return _find("tables", "sample table", name)


def constants(name: str) -> Path:
    """Path of a table of published constants (CSV; its comment lines name the source): "ward_1992", ...

    Raises SpecError for a name that does not exist, or where the data was not installed.
    """
    return _find("constants", "table of constants", name)


def databases() -> dict[str, Database]:
    """The public databases of measured tables, by name: what they hold, licence, citation, addresses."""
    from fitter import databases as catalogue

    return catalogue.databases()


def get(
    database: str, items: Sequence[str], folder: str | Path = ".", *, source: str | None = None,
    progress: Progress | None = None,
) -> list[Fetched]:  # fmt: skip
    """Download files of a public database into ``folder``: see :func:`fitter.databases.get`."""
    from fitter import databases as catalogue
    from fitter.progress import ignore

    return catalogue.get(database, items, folder, source=source, progress=progress or ignore)


def data_folder(kind: str, what: str) -> Path:
    """The folder of data that ships with the product. Raises SpecError where it was not installed."""
    # A wheel carries the data inside the package; in the source tree it lies beside it.
    for folder in (_HERE / "_data" / kind, _HERE.parent / "data" / kind):
        if folder.is_dir():
            return folder
    raise SpecError(
        f"no {what} is installed", code="data-missing", file=str(_HERE / "_data" / kind),
        cause="the package was copied without its data folder", remedy="install brdf-fitter from its wheel",
    )  # fmt: skip


def _files(kind: str, what: str) -> list[Path]:
    return sorted(data_folder(kind, what).glob("*.csv"))


def _find(kind: str, what: str, name: str) -> Path:
    known = {path.stem: path for path in _files(kind, what)}
    if name not in known:
        raise SpecError(
            f"there is no {what} {name!r}", code="unknown-dataset", parameter="name",
            remedy=f"use one of {', '.join(known)}",
        )  # fmt: skip
    return known[name]


def _description(path: Path) -> str:
    with path.open(encoding="utf-8") as lines:
        for line in lines:
            if not line.startswith("#"):
                break
            key, _, text = line.lstrip("# ").partition(":")
            if key == "description":
                return text.strip()
    return ""
