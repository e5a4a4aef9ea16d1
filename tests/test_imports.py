"""Imports point one way, and importing the package costs next to nothing.

``ROOMS`` is the drawing: a room may use those before it. What is not in it is a module of the package's
own folder, which every room may use and which uses no room. Imports for types alone don't count: they don't
run. Imports inside functions run late: against the order they are allowed where ``LATE`` says why.
"""

from __future__ import annotations

import ast
import functools
import graphlib
import json
import resource
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "fitter"
ROOMS = (
    "kernels", "sampling", "formats", "large", "quality", "compression", "models", "fitting", "selection",
    "posterior", "report", "views", "scene", "export", "tradeoffs", "calibration", "batch", "cli",
)  # fmt: skip
#: Imports against the order, by file and room, that run when the file is imported; the reason of each.
AGAINST: dict[tuple[str, str], str] = {}
#: The same inside functions.
LATE = {
    ("table.py", "formats"): "Table.to_arrow and its like are what formats write",
    ("table.py", "sampling"): "Table.evaluate is the interpolant that is drawn from",
    ("table.py", "report"): "Table.plot is the report's picture",
    ("formats/compressed.py", "compression"): "a container is one more format",
    ("fitting/engine.py", "selection"): "fit(table, 'auto') is a comparison of fits",
}  # fmt: skip


@dataclass(frozen=True)
class Import:
    """One import: of ``module``, in ``file`` (from the package's folder), inside a function or not."""

    file: str
    module: str
    late: bool

    @property
    def rooms(self) -> tuple[str, str]:
        """Where it stands and where it leads, "" for the package's own modules."""
        here, there = self.file.split("/")[0].removesuffix(".py"), self.module.split(".")[1]
        return tuple(name if name in ROOMS else "" for name in (here, there))  # pyright: ignore[reportReturnType]


@functools.cache
def imports() -> tuple[Import, ...]:
    """Every import within the package that ever runs."""
    found: list[Import] = []
    for path in sorted(PACKAGE.rglob("*.py")):
        file = path.relative_to(PACKAGE).as_posix()
        found += _of(ast.parse(path.read_text()), file, late=False)
    return tuple(found)


def _of(node: ast.AST, file: str, late: bool) -> Iterator[Import]:
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return
    late = late or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
    if isinstance(node, ast.Import):
        yield from (Import(file, name.name, late) for name in node.names if name.name.startswith("fitter."))
    elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "fitter":
        for name in node.names:
            whole = f"{node.module}.{name.name}"
            if _path(whole) is not None:
                yield Import(file, whole, late)
            elif node.module != "fitter":
                yield Import(file, node.module, late)
    for child in ast.iter_child_nodes(node):
        yield from _of(child, file, late)


def _path(module: str) -> Path | None:
    """The file of a module or package of ours, if there is one."""
    path = ROOT.joinpath(*module.split("."))
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)


def against() -> set[tuple[str, str, bool]]:
    found: set[tuple[str, str, bool]] = set()
    for one in imports():
        here, there = one.rooms
        if one.file in ("__init__.py", "__main__.py") or not there or here == there:
            continue
        if not here or ROOMS.index(there) > ROOMS.index(here):
            found.add((one.file, there, one.late))
    return found


def test_every_folder_is_a_room() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders <= set(ROOMS)
    assert all(_path(f"fitter.{room}") for room in ROOMS)


def test_rooms_use_those_before_them() -> None:
    """Both ways: an exception that is not needed any more has to go."""
    found = against()
    assert {(file, room) for file, room, late in found if not late} == set(AGAINST)
    assert {(file, room) for file, room, late in found if late} == set(LATE)


def test_no_module_needs_itself_to_be_imported() -> None:
    graph: dict[str, set[str]] = {}
    for one in imports():
        target = _path(one.module)
        if not one.late and target is not None:
            graph.setdefault(one.file, set()).add(target.relative_to(PACKAGE).as_posix())
    assert len(graph) > 200
    assert list(graphlib.TopologicalSorter(graph).static_order())


def test_the_library_knows_no_service() -> None:
    """But for verbs of the command that run or ask one, when they are called."""
    for path in PACKAGE.rglob("*.py"):
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(name.split(".")[0] == "api" for name in names):
                assert path.is_relative_to(PACKAGE / "cli"), path
                assert node not in tree.body, f"{path}: at the top"


def loaded(code: str) -> set[str]:
    """Top-level modules that a fresh Python has after ``code``."""
    code += "\nimport json, sys\nprint(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(json.loads(done.stdout))


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import fitter", {"numpy", "scipy", "jax", "fastapi", "pydantic", "matplotlib", "pyarrow", "api"}),
        ("import fitter; fitter.load; fitter.Table", {"jax", "fastapi", "matplotlib", "api"}),
        ("import fitter; fitter.TableSampler; fitter.check", {"jax", "fastapi", "matplotlib", "api"}),
        ("import fitter; fitter.fit; fitter.posterior", {"fastapi", "sqlalchemy", "matplotlib", "api"}),
    ],
)  # fmt: skip
def test_nothing_is_loaded_before_it_is_needed(code: str, absent: set[str]) -> None:
    assert not loaded(code) & absent


@pytest.mark.parametrize(
    ("words", "limit"),
    [(("-c", "import fitter"), 0.3), (("-m", "fitter", "--help"), 0.5)],
    ids=["import", "help"],
)
def test_it_starts_at_once(words: tuple[str, ...], limit: float) -> None:
    """Processor time, since wall time is also that of everything else on the machine."""

    def once() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *words], check=True, capture_output=True, cwd=ROOT)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    assert min(once() for _ in range(3)) < limit
