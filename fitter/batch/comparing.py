"""Comparing two batches, or two fits: what has changed beyond its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fitter.batch.planning import TABLES
from fitter.batch.records import KIND, RECORD
from fitter.batch.summing import rows_of
from fitter.documents import read_document
from fitter.errors import SpecError

#: Differences of more than so many standard uncertainties of themselves are listed.
COVERAGE = 2.0
#: Of metrics that have no uncertainty: the share by which one has to change to be listed.
METRIC = 0.01
_METRICS = ("rmse", "relative_rmse")


@dataclass(frozen=True)
class Comparison:
    """Two batches or fits, row by row of those that both have.

    changed : each with table, model, ``what`` and the two values; parameters with ``score`` = difference over
        its standard uncertainty, in which the two are taken as independent: of fits of the same samples that
        is too large.
    only_a, only_b : rows that one alone has, as (table, model).
    compared : rows that both have; parameters : of these, that were compared.
    """

    changed: tuple[Mapping[str, Any], ...]
    only_a: tuple[tuple[str, str], ...]
    only_b: tuple[tuple[str, str], ...]
    compared: int
    parameters: int
    coverage: float

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "kind": "brdf-fitter/comparison", "changed": [dict(one) for one in self.changed],
            "only_a": [list(one) for one in self.only_a], "only_b": [list(one) for one in self.only_b],
            "compared": self.compared, "parameters": self.parameters, "coverage": self.coverage,
        }  # fmt: skip


def compare(a: str | Path, b: str | Path, *, coverage: float = COVERAGE) -> Comparison:
    """What differs between two batches' folders, or two files of fits.

    Raises SpecError for what is neither, or for a batch beside a fit.
    """
    rows_a, rows_b = _rows(Path(a)), _rows(Path(b))
    if Path(a).is_dir() != Path(b).is_dir():
        raise SpecError(
            "one is a batch and the other a fit", code="bad-comparison", parameter="B",
            remedy="give two folders of batches, or two files of fits",
        )  # fmt: skip
    both = sorted(set(rows_a) & set(rows_b))
    changed: list[Mapping[str, Any]] = []
    parameters = 0
    for key in both:
        found, count = _differences(rows_a[key], rows_b[key], coverage)
        changed += [{"table": key[0], "model": key[1], **one} for one in found]
        parameters += count
    return Comparison(
        tuple(changed), tuple(sorted(set(rows_a) - set(rows_b))), tuple(sorted(set(rows_b) - set(rows_a))),
        len(both), parameters, coverage,
    )  # fmt: skip


def _differences(
    a: Mapping[str, Any], b: Mapping[str, Any], coverage: float
) -> tuple[list[dict[str, Any]], int]:
    found: list[dict[str, Any]] = []
    if a["status"] != b["status"]:
        found.append({"what": "status", "a": a["status"], "b": b["status"]})
    for name in _METRICS:
        if a[name] is not None and b[name] is not None and not math.isclose(a[name], b[name], rel_tol=METRIC):
            found.append({"what": name, "a": a[name], "b": b[name]})
    labels = [name[2:-1] for name in a if name.startswith("u(") and name in b]
    for label in labels:
        u = math.hypot(*(row[f"u({label})"] or 0.0 for row in (a, b)))
        difference = b[label] - a[label]
        score = difference / u if u > 0 else math.copysign(math.inf, difference) if difference else 0.0
        if abs(score) > coverage:
            stated = u > 0
            found.append(
                {
                    "what": label, "a": a[label], "b": b[label], "u_a": a[f"u({label})"],
                    "u_b": b[f"u({label})"], "score": score if stated else None,
                }
            )  # fmt: skip
    return found, len(labels)


def _rows(path: Path) -> dict[tuple[str, str], Mapping[str, Any]]:
    """Rows of the summary by table and model."""
    if not path.is_dir():
        return _fits(path)
    tables: list[Mapping[str, Any]] = []
    for record in sorted((path / TABLES).glob(f"*/{RECORD}")):
        document = read_document(record, "not-a-batch")
        if document.get("kind") == KIND:
            tables += document["tables"]
    if not tables:
        raise SpecError(
            f"{path} holds no batch", code="not-a-batch", file=str(path),
            remedy="give the folder that `brdf-fitter batch --out` wrote",
        )  # fmt: skip
    return {(row["table"], row["model"]): row for table in tables for row in rows_of(table, 0)}


def _fits(path: Path) -> dict[tuple[str, str], Mapping[str, Any]]:
    from fitter.batch.working import row_of
    from fitter.fitting.result import load_fits

    found: dict[tuple[str, str], Mapping[str, Any]] = {}
    for result in load_fits(path):
        about = dict.fromkeys(
            ("samples", "usable", "read_seconds", "format", "path", "member", "folder", "sha256", "hash")
        )
        # One table in two files need not have one name: what is compared is the model.
        table = {"table": "", "fits": [row_of(result)], **about}
        (row,) = rows_of(table, result.spec.seed)
        found["", row["model"]] = row
    return found
