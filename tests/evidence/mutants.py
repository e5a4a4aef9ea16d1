"""Mutants: small faults put into the numerics, one at a time, and whether the tests of their room see them.

A fault is another operator, another constant, a comparison turned round, a sine for a cosine, anywhere but in
annotations, texts and errors. Faults are drawn evenly from all that a room offers. Some change nothing that
could be seen (a bound that is never reached, a constant that only decides how fast): those count as missed.
"""

from __future__ import annotations

import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from scipy import stats

from tests.evidence.study import Outcome, Study

ROOT = Path(__file__).resolve().parents[2]
#: Faults of a full run, and the share of them that tests have to see; None where it is only stated.
ROOMS: dict[str, tuple[int, float | None]] = {
    "models": (240, 0.85), "fitting": (120, None), "sampling": (120, None),
}  # fmt: skip
#: A run of the tests that takes longer (seconds) has seen the fault.
LONGEST = 1800.0

_OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.And: ast.Or, ast.Or: ast.And, ast.USub: ast.UAdd,
}  # fmt: skip
_NAMES = {
    "sin": "cos", "cos": "sin", "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum",
    "any": "all", "all": "any", "sum": "max", "floor": "ceil", "exp": "expm1", "log1p": "log",
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One fault: its file, from the root; its place among those the file offers; line; what it changes."""

    path: str
    place: int
    line: int
    change: str

    def source(self) -> str:
        """The file with the fault."""
        tree = ast.parse((ROOT / self.path).read_text())
        _changed(_places(tree)[self.place])
        return ast.unparse(tree)


class _Places(ast.NodeVisitor):
    """The nodes that can be changed: not in annotations, texts, errors, decorators or imports for types."""

    def __init__(self) -> None:
        self.found: list[ast.AST] = []

    def visit(self, node: ast.AST) -> None:
        if isinstance(node, (ast.Raise, ast.JoinedStr, ast.Assert)) or _is_checking(node):
            return
        if _changed(copy.copy(node)) is not None:
            self.found.append(node)
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "type_comment", "bases"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    self.visit(child)


def _is_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def _changed(node: ast.AST) -> ast.AST | None:
    """The node with its fault, changed in place; None where it offers none."""
    if isinstance(node, (ast.BinOp, ast.BoolOp, ast.UnaryOp)):
        other = _OPERATORS.get(type(node.op))
        if other is None:
            return None
        node.op = other()  # type: ignore[assignment]
        return node
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in _OPERATORS:
        node.ops = [_OPERATORS[type(node.ops[0])]()]  # type: ignore[list-item]
        return node
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        node.value = node.value + 1
        return node
    if isinstance(node, ast.Attribute) and node.attr in _NAMES:
        node.attr = _NAMES[node.attr]
        return node
    return None


def _places(tree: ast.AST) -> list[ast.AST]:
    looked = _Places()
    looked.visit(tree)
    return looked.found


def mutants(room: str) -> list[Mutant]:
    """All faults that the modules of a room of ``fitter`` offer, in the order of the source."""
    found: list[Mutant] = []
    for path in sorted((ROOT / "fitter" / room).rglob("*.py")):
        for place, node in enumerate(_places(ast.parse(path.read_text()))):
            before, line = ast.unparse(node), getattr(node, "lineno", 0)
            _changed(node)
            change = f"{before} -> {ast.unparse(node)}"
            found.append(Mutant(path.relative_to(ROOT).as_posix(), place, line, change))
    return found


def tests_of(room: str, stem: str) -> list[str]:
    """The room's test files: those of the module's name first, then those that all of the room's modules have
    to pass."""
    files = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "tests" / room).rglob("test_*.py"))
    first = (f"test_{stem}.py", "test_oracles.py", f"test_{room}.py")
    return sorted(files, key=lambda file: [name not in file for name in first])


def failure(place: Path, tests: Sequence[str]) -> str | None:
    """What the tests say in a copy of the project where one of them fails, None where all pass. Those that
    take long come last."""
    environment = {
        **os.environ, "PYTHONPATH": str(place), "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "",
        "JAX_COMPILATION_CACHE_DIR": str(place.parent / "programs"),
        "BRDF_SHARED": os.environ.get("BRDF_SHARED", str(ROOT.parent / "shared")),
    }  # fmt: skip
    for which in ("not long", "long"):
        words = [sys.executable, "-m", "pytest", "-x", "-n", "0", "-m", which, "--hypothesis-seed=0", *tests]
        try:
            ran = subprocess.run(
                words, cwd=place, env=environment, capture_output=True, text=True, timeout=LONGEST
            )
        except subprocess.TimeoutExpired:
            return f"no end within {LONGEST:g} s"
        if ran.returncode == 5:
            raise RuntimeError(f"no {which} tests among {tests}")
        if ran.returncode:
            return ran.stdout[-2000:]
    return None


def _copied(folder: Path) -> Path:
    """The project, copied into ``folder``."""
    place = folder / "project"
    place.mkdir()
    for name in ("fitter", "api", "tests", "data", "docs"):
        shutil.copytree(ROOT / name, place / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", place)
    return place


def judge(room: str, share: float, seed: int) -> Outcome:
    count, asked = ROOMS[room]
    every = mutants(room)
    drawn = random.Random(seed).sample(every, min(len(every), max(2, round(count * share))))
    missed: list[Mutant] = []
    with tempfile.TemporaryDirectory() as name:
        # One copy for all: what Python, JAX and Numba keep of the modules that don't change is not made anew.
        place = _copied(Path(name))
        # Tests that fail anyway see everything; and the programs they share are compiled by then.
        if (why := failure(place, tests_of(room, ""))) is not None:
            raise RuntimeError(f"the tests of {room} fail without any fault:\n{why}")
        for k, one in enumerate(drawn):
            path = place / one.path
            sound = path.read_text()
            path.write_text(one.source())
            began = time.monotonic()
            seen_by_tests = failure(place, tests_of(room, path.stem)) is not None
            path.write_text(sound)
            if not seen_by_tests:
                missed.append(one)
            print(
                f"mutants: {room} {k + 1} of {len(drawn)} {'seen' if seen_by_tests else 'MISSED'}, "
                f"{time.monotonic() - began:.0f} s: {one.path}:{one.line} {one.change}",
                file=sys.stderr, flush=True,
            )  # fmt: skip
    seen = len(drawn) - len(missed)
    figures = {
        "possible": len(every), "tried": len(drawn), "seen": seen, "share": round(seen / len(drawn), 3),
        "missed": [f"{one.path}:{one.line} {one.change}" for one in missed],
    }  # fmt: skip
    # Too few, and not by chance.
    too_few = asked is not None and stats.binomtest(seen, len(drawn), asked, "less").pvalue < 0.01
    violations = [{"seen": seen, "tried": len(drawn), "asked": asked}] if too_few else []
    return Outcome(figures, violations)


STUDY = Study(
    "mutants", "Faults put into the numerics",
    "Of small faults in fitter.models, drawn evenly, the room's own tests see 85 %; of fitter.fitting and "
    "fitter.sampling the figure is stated.",
    ("possible", "tried", "seen", "share"), lambda: tuple(ROOMS), judge, subject="room",
)  # fmt: skip
