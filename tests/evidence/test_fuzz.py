"""The study of damaged files finds what it is there to find, and says how to make it again."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Sequence
from io import BytesIO
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import pytest

from fitter.errors import TableError
from fitter.table import Table
from tests.evidence import fuzz, trial
from tests.evidence.inputs import Input, formats, inputs
from tests.evidence.mutations import MUTATIONS, mutate
from tests.formats.samples import SAMPLES

ONE = next(one for one in inputs() if one.name == "made/fred.dat")


def test_every_format_and_every_measured_file_is_damaged():
    assert {s.name for s in SAMPLES} | {"compressed", "curet", "utia"} <= set(formats())
    measured = sum(one.measured for one in inputs())
    total = fuzz.MEASURED * measured + fuzz.MADE * (len(inputs()) - measured)
    assert total >= 10_000 or not measured


@pytest.mark.parametrize("name", MUTATIONS)
def test_mutations_change_bytes_and_can_be_made_again(name: str):
    other = next(one for one in inputs() if one.name == "made/astm.dat").files["astm.dat"]
    for data in (ONE.files["fred.dat"], np.arange(300, dtype="<f4").tobytes(), b"1", b"\n\n"):
        made = [[MUTATIONS[name](data, other, np.random.default_rng(k)) for k in range(20)] for _ in range(2)]
        assert made[0] == made[1]
        assert any(one != data for one in made[0]) or len(data) < 3
        assert all(len(one) <= 2 * len(data) + len(other) + 500 for one in made[0])
    drawn = [mutate(ONE.files["fred.dat"], other, np.random.default_rng(k))[0] for k in range(200)]
    assert {kind.split(",")[0] for kind in drawn} == set(MUTATIONS)


def test_a_record_can_be_made_again():
    for number in range(5):
        first, second = (trial.trial(ONE, 3, number) for _ in range(2))
        assert first["outcome"] in ("table", "error")
        measured = dict.fromkeys(("seconds", "times", "over"))
        assert first | measured == second | measured


def returned(value: np.ndarray) -> list[Table]:
    up = np.tile([0.0, 0.0, 1.0], (len(value), 1))
    return [Table(wi=up, wo=up, value=value, duplicates="keep")]


def untyped() -> list[Table]:
    raise ValueError("bad")


def nameless() -> list[Table]:
    raise TableError("bad", code="table-bad", remedy="none")


def helpless() -> list[Table]:
    raise TableError("bad", code="table-bad", file="fred.dat")


def warned() -> list[Table]:
    warnings.warn("careful", RuntimeWarning, stacklevel=1)
    return returned(np.ones(3))


def greedy() -> list[Table]:
    _ = np.ones(1_000_000)
    return returned(np.ones(3))


def contradictory() -> list[Table]:
    tables = returned(np.ones(3))
    tables[0].mask = np.array([True, False, True])
    return tables


def fine() -> list[Table]:
    return returned(np.ones(3))


@pytest.mark.parametrize(
    ("does", "what"),
    [
        (untyped, "ValueError: bad"), (nameless, "names the file"), (helpless, "no code or no remedy"),
        (warned, "RuntimeWarning"), (greedy, "bytes beyond the result"), (contradictory, "not all counted"),
        (fine, None),
    ],
)  # fmt: skip
def test_a_fault_is_found(monkeypatch: pytest.MonkeyPatch, does: Any, what: str | None):
    def read(one: Input, sources: Sequence[BytesIO]) -> list[Table]:
        return does()

    monkeypatch.setattr(trial, "read", read)
    record = trial.trial(ONE, 3, 1)
    assert (record["outcome"] == "fault") is (what is not None)
    assert what is None or what in record["what"]


def badly(pipe: Connection, name: str, seed: int, numbers: Sequence[int]) -> None:
    """Dies on 1, hangs on 3."""
    pipe.send(None)
    for number in numbers:
        if number == 1:
            os._exit(7)
        if number == 3:
            time.sleep(60)
        pipe.send({"number": number, "outcome": "table"})


@pytest.mark.long
def test_hangs_and_crashes_are_told_and_the_rest_goes_on():
    began = time.perf_counter()
    found = list(fuzz.records(ONE, 3, range(5), target=badly, longest=3.0))
    assert [record["number"] for record in found] == [0, 1, 2, 3, 4]
    assert [record["outcome"] for record in found] == ["table", "fault", "table", "fault", "table"]
    assert "died (exit status 7)" in found[1]["what"]
    assert "longer than 3 s" in found[3]["what"]
    assert time.perf_counter() - began < 60


def test_a_share_of_the_study_passes():
    found = fuzz.judge("integra", 0.05, 9)
    assert not found.violations
    assert found.figures["mutations"] == 5
    assert found.figures["tables"] + found.figures["typed errors"] == 5
