"""A metrologist's question: what is the uncertainty of each parameter, and where does it come from?

    python examples/uncertainty_budget.py [TABLE] [--model torrance_sparrow]

Without a table the bundled glossy paint is taken. Every source is a column, as a share of the estimate; what
the table does not state is a dash, and in no number. The words are in docs/uncertainty.md.
"""

from __future__ import annotations

import argparse
from typing import Any

import fitter
from fitter import datasets, report


def budget(table: fitter.Table, model: str) -> dict[str, Any]:
    """The report's budget: its sources, and a row for each parameter and channel."""
    fit = fitter.fit(table, model)
    print(f"{model}: {fit.status}, relative rmse {fit.metrics['relative_rmse']:.3f}")
    made = report.build(
        table, fit,
        without_scans=fitter.posterior.robust(table, fit),
        offsets=fitter.posterior.offset_sensitivities(table, fit),
    )  # fmt: skip
    found: dict[str, Any] = made.record["budget"]
    return found


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", nargs="?", default=datasets.sample("glossy_paint"))
    parser.add_argument("--model", default="torrance_sparrow")
    given = parser.parse_args(words)

    table = fitter.load(given.table)
    found = budget(table, given.model)

    sources = [one["source"] for one in found["sources"]]
    for one in found["sources"]:
        print(
            f"  {one['source']}: type {one['type']}{'' if one['stated'] else ', not stated'}; {one['words']}"
        )
    print("".join(f"{word:>14}" for word in ("parameter", "y", *sources, "u", "k", "U")))
    for row in found["rows"]:
        parts = [row["components"][source]["standard_uncertainty"] for source in sources]
        # Of an estimate of 0 there is no share.
        y = row["estimate"]
        shares = ["-" if u is None or not y else f"{100 * abs(u / y):.2g} %" for u in parts]
        text = row["text"]
        cells = (row["label"], text["estimate"], *shares, text["combined"], text["factor"], text["expanded"])
        print("".join(f"{cell:>14}" for cell in cells))


if __name__ == "__main__":
    main()
