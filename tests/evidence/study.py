"""What a study is: a module of this package with an attribute ``STUDY``, found by name."""

from __future__ import annotations

import importlib
import pkgutil
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Outcome:
    """What a study found out about one model (or other subject); JSON-ready.

    figures : by column; violations : each a sentence-like record of one point that broke the bound.
    """

    figures: Mapping[str, Any]
    violations: Sequence[Mapping[str, Any]] = ()


@dataclass(frozen=True)
class Study:
    """One question asked of every model, or of every one of another kind of subject.

    claim : what has to hold, in a sentence for the page; judge : (model name, share, seed) -> Outcome, in a
    process of its own; ``share`` scales the number of points; skipped : model name -> why it is not asked;
    subject : what ``models`` names. A run of chosen models leaves out studies of other subjects. least : of a
    study whose cost is in its subjects, not their points, a share asks a share of them, this many at least.
    """

    name: str
    title: str
    claim: str
    columns: tuple[str, ...]
    models: Callable[[], Sequence[str]]
    judge: Callable[[str, float, int], Outcome]
    skipped: Mapping[str, str] = field(default_factory=dict[str, str])
    subject: str = "model"
    least: int | None = None

    def asked(self, share: float, seed: int) -> list[str]:
        """The names that a run asks of: all, or a share of them, chosen by the seed."""
        names = list(self.models())
        if self.least is None or share >= 1:
            return names
        return random.Random(seed).sample(names, min(len(names), max(self.least, round(share * len(names)))))


def studies() -> dict[str, Study]:
    """Every study of the package, by name."""
    package = importlib.import_module("tests.evidence")
    found: dict[str, Study] = {}
    for module in sorted(one.name for one in pkgutil.iter_modules(package.__path__)):
        if module.startswith(("test_", "__")):
            continue
        study = getattr(importlib.import_module(f"tests.evidence.{module}"), "STUDY", None)
        if isinstance(study, Study):
            found[study.name] = study
    return found
