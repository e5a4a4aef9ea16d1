"""The plan: which files are read for which output folder, found out before anything is fitted."""

from __future__ import annotations

import csv
import glob
import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from fitter.batch.specification import SERVER, BatchSpec
from fitter.documents import file_stem
from fitter.errors import SpecError, TableError
from fitter.formats import archives
from fitter.formats.read_options import read_options
from fitter.formats.registry import Format, detect
from fitter.formats.source import Source

#: Folder of a unit's outputs below the batch's.
TABLES = "tables"
_MANIFEST_OPTIONS = ("quantity", "convention", "item", "negatives", "duplicates", "fills")


@dataclass(frozen=True)
class Unit:
    """Files that one worker reads together: a file, a member of an archive, or a measurement's several files.

    name : of its folder below ``tables``. format : as detected, "" where nobody could tell. size : in bytes.
    """

    name: str
    paths: tuple[str, ...]
    member: str | None = None
    format: str = ""
    size: int = 0
    reading: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)

    @staticmethod
    def from_dict(document: Mapping[str, Any]) -> Unit:
        """The inverse of :meth:`to_dict`."""
        fields: dict[str, Any] = {**document, "paths": tuple(document["paths"])}
        return Unit(**fields)

    def key(self, work: str) -> str:
        """What its results depend on: the ``work`` to be done, the files as they lie there."""
        stated = [(p, s.st_size, s.st_mtime_ns) for p, s in ((p, Path(p).stat()) for p in self.paths)]
        told = json.dumps([work, self.name, stated, self.member, dict(self.reading)], sort_keys=True)
        return hashlib.sha256(told.encode()).hexdigest()[:32]


@dataclass(frozen=True)
class Plan:
    """The units in the order in which they are begun, and what is left out, each with its error."""

    spec: BatchSpec
    units: tuple[Unit, ...]
    refused: tuple[Mapping[str, Any], ...] = ()

    @cached_property
    def work(self) -> str:
        """What is asked for every unit, in one spelling: without the tables."""
        asked = self.spec.model_dump(mode="json", exclude={"tables", "manifest", "reading"})
        return json.dumps(asked, sort_keys=True)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "units": [unit.to_dict() for unit in self.units], "refused": [dict(one) for one in self.refused],
            "models": self.spec.models if isinstance(self.spec.models, str)
            else [model.name for model in self.spec.models],
        }  # fmt: skip


@dataclass(frozen=True)
class Fetched:
    """A service's table, here: the file of its bytes, its name, and how it is read."""

    path: Path
    name: str
    reading: Mapping[str, Any]


def plan(spec: BatchSpec, fetched: Mapping[str, Fetched] | None = None) -> Plan:
    """Find the files. Formats are told by the files' first bytes; nothing is read further.

    fetched : of every table ``server:ID`` what has come of it.

    Raises
    ------
    SpecError : a pattern that matches nothing, a path that isn't there, two tables of one name, a bad
        manifest, a service's table that wasn't fetched.
    """
    units: list[Unit] = []
    refused: list[Mapping[str, Any]] = []
    for unit, error in _units(spec, fetched or {}):
        if error is None:
            units.append(unit)
        else:
            refused.append({"table": unit.name, "path": unit.paths[0], "error": error.to_dict()})
    _refuse_twins([*units, *(Unit(one["table"], (one["path"],)) for one in refused)])
    # Tables of one format and size lie side by side, so that a worker's compiled programs serve the next; the
    # large ones come first, so that none begins when all other workers are about to end.
    largest: dict[str, int] = {}
    for unit in units:
        largest[unit.format] = max(unit.size, largest.get(unit.format, 0))
    units.sort(key=lambda unit: (-largest[unit.format], unit.format, -unit.size, unit.name))
    return Plan(spec, tuple(units), tuple(refused))


def _units(spec: BatchSpec, fetched: Mapping[str, Fetched]) -> Iterator[tuple[Unit, TableError | None]]:
    reading = dict(spec.reading)
    for pattern in spec.tables:
        if not pattern.startswith(SERVER):
            yield from _told(_files_of(pattern), reading)
        elif pattern in fetched:
            one = fetched[pattern]
            for unit, error in _told([one.path], {**reading, **one.reading}, whole=True):
                yield _renamed(unit, one.name), error
        else:
            raise SpecError(
                f"{pattern} is a table of a service", code="batch-no-server", parameter="server",
                remedy="say which one: brdf-fitter --server URL batch ...",
            )  # fmt: skip
    if spec.manifest is not None:
        for path, name, options in _manifest(Path(spec.manifest)):
            for unit, error in _told([path], {**reading, **options}):
                yield (unit if name is None else _renamed(unit, name)), error


def _files_of(pattern: str) -> list[Path]:
    path = Path(pattern)
    if path.is_dir():
        found = [p for p in sorted(path.iterdir()) if p.is_file() and not p.name.startswith(".")]
    elif path.exists() or not glob.has_magic(pattern):
        found = [path] if path.is_file() else []
    else:
        found = [Path(p) for p in sorted(glob.glob(pattern, recursive=True)) if Path(p).is_file()]
    if not found:
        there = "holds no files" if path.is_dir() else "matches no file"
        raise SpecError(
            f"{pattern} {there}", code="batch-no-tables", parameter="tables",
            cause="a wrong folder, or a pattern that the shell has changed",
            remedy="check the path; quote patterns",
        )  # fmt: skip
    return found


def _told(
    files: Sequence[Path], reading: Mapping[str, Any], *, whole: bool = False
) -> Iterator[tuple[Unit, TableError | None]]:
    """The units of files, archives opened, and measurements of several files in one folder put together.

    whole : an archive is one table, also where it does not say which.
    """
    together: dict[tuple[str, Path], list[Path]] = {}
    for path in files:
        try:
            source = Source(path)
            if archives.is_archive(source):
                if "item" in reading or whole:
                    unit = _unit(path.stem, [path], None, reading)
                    yield replace(unit, format="zip"), None
                else:
                    yield from _members(path, source, reading)
                continue
            entry = detect(source)
        except TableError as error:
            error.file = error.file or path.name
            yield _unit(path.stem, [path], None, reading), error
            continue
        if entry.together is not None and len(files) > 1:
            together.setdefault((entry.name, path.parent), []).append(path)
            continue
        yield _unit(path.stem, [path], entry, reading), None
    for (name, folder), paths in together.items():
        size = sum(path.stat().st_size for path in paths)
        words = tuple(str(path.resolve()) for path in paths)
        yield Unit(folder_name(folder.resolve().name), words, None, name, size, reading), None


def _unit(name: str, paths: Sequence[Path], entry: Format | None, reading: Mapping[str, Any]) -> Unit:
    size = sum(path.stat().st_size for path in paths if path.exists())
    words = tuple(str(path.resolve()) for path in paths)
    return Unit(folder_name(name), words, None, "" if entry is None else entry.name, size, reading)


def _members(path: Path, source: Source, reading: Mapping[str, Any]) -> Iterator[tuple[Unit, None]]:
    with archives.opened(source, path) as content:
        listed = archives.files(content)
    for member in listed:
        name = folder_name("-".join((path.stem, *Path(member.filename).with_suffix("").parts)))
        yield Unit(name, (str(path.resolve()),), member.filename, "zip", member.file_size, reading), None


def _manifest(path: Path) -> Iterator[tuple[Path, str | None, dict[str, Any]]]:
    """(file, name, reading options) of each row."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SpecError(
            f"the manifest can't be read: {error}", code="bad-manifest", file=str(path), parameter="manifest",
            remedy="give a CSV file with a column called path",
        ) from error  # fmt: skip
    known = ("path", "name", *_MANIFEST_OPTIONS)
    for number, row in enumerate(rows, start=2):
        given = {key: text for key, text in row.items() if text}
        unknown = sorted(str(key) for key in row if key not in known)
        if unknown or "path" not in given:
            raise SpecError(
                f"the manifest has a column {unknown[0]!r}" if unknown else "the row names no path",
                code="bad-manifest", file=str(path), row=1 if unknown else number, parameter="manifest",
                remedy=f"the columns are {', '.join(known)}",
            )  # fmt: skip
        file = path.parent / given.pop("path")
        if not file.exists():
            raise SpecError(
                f"{file} is not there", code="batch-no-tables", file=str(path), row=number,
                parameter="manifest", remedy="paths are relative to the manifest's folder",
            )  # fmt: skip
        name = given.pop("name", None)
        try:
            yield file, name, read_options(given).to_dict()
        except SpecError as error:
            error.file, error.row = str(path), number
            raise
    if not rows:
        raise SpecError(
            "the manifest names no table", code="batch-no-tables", file=str(path), parameter="manifest",
            remedy="write one row for each table",
        )  # fmt: skip


def _renamed(unit: Unit, name: str) -> Unit:
    suffix = "" if unit.member is None else f"-{folder_name(Path(unit.member).stem)}"
    return replace(unit, name=folder_name(name) + suffix)


def _refuse_twins(units: Sequence[Unit]) -> None:
    seen: dict[str, Unit] = {}
    for unit in units:
        # Where upper and lower case are one to the file system, they are one here.
        other = seen.setdefault(unit.name.casefold(), unit)
        if other is not unit:
            raise SpecError(
                f"{other.paths[0]} and {unit.paths[0]} would both write {TABLES}/{unit.name}",
                code="batch-same-name", parameter="tables",
                cause="a file named twice, or files of one name in several folders",
                remedy="leave one out, or give each a name in a manifest",
            )  # fmt: skip


def folder_name(name: str) -> str:
    """A name that every file system takes; longer than a table's may be, since it holds an archive's, too."""
    return file_stem(name, 120)


def folder_names(items: Sequence[str], taken: str) -> list[str]:
    """Names of folders beside a file called ``taken``, no two alike where upper and lower case are one."""
    stems = [folder_name(item) for item in items]
    often = Counter([taken, *(stem.casefold() for stem in stems)])
    found: list[str] = []
    for k, stem in enumerate(stems):
        name = stem
        while often[name.casefold()] > (name == stem):
            name = f"{name}-{k}"
        found.append(name)
    return found
