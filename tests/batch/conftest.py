"""Small tables to fit in batches."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

Write = Callable[[Path, float], Path]


@pytest.fixture(scope="session")
def write_table() -> Write:
    """Write a matte table of that albedo and 2 % noise as delimited text."""

    def write(path: Path, albedo: float) -> Path:
        rng = np.random.default_rng(round(1e6 * albedo))
        rows = ["theta_i_deg,theta_o_deg,dphi_deg,brdf"]
        for theta_i in (10, 40, 70):
            for theta_o in range(0, 80, 10):
                for dphi in (0, 60, 120, 180):
                    value = albedo / np.pi * (1 + 0.02 * rng.standard_normal())
                    rows.append(f"{theta_i},{theta_o},{dphi},{value!r}")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join([*rows, ""]))
        return path

    return write


def summary_rows(out: Path) -> list[dict[str, str]]:
    """The rows of a batch's summary."""
    with (out / "summary.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def rows_without_times(out: Path) -> list[dict[str, str]]:
    """What of the rows has to be the same, however the batch came about."""
    return [{name: text for name, text in row.items() if "seconds" not in name} for row in summary_rows(out)]
