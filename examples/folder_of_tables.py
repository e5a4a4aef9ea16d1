"""A folder of tables overnight: fit them all, list what deserves a look, compare with another night.

    python examples/folder_of_tables.py [FOLDER] [--out night]

Without a folder two of the bundled tables are taken. Run it again and nothing is done twice; the same from
a shell is `brdf-fitter batch` and `brdf-fitter compare` (docs/batch.md).
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

from fitter import batch, datasets

SAMPLES = ("diffuse_plaster", "glossy_paint")
#: A fit further off than this deserves a look.
LOOK = 0.5


def night(tables: list[str], metric: str, out: Path) -> Path:
    """Fit every table under a metric; the folder of the results."""
    spec = batch.batch_spec({"tables": tables, "models": ["oren_nayar"], "metric": metric, "report": False})
    done = batch.run(batch.plan(spec), out, workers=1)
    print(f"{out}: {done.done} done in {done.seconds:.1f} s, {done.kept} were there, {done.failed} failed")
    return done.folder


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--out", type=Path, default=Path("night"))
    given = parser.parse_args(words)
    found = [datasets.sample(name) for name in SAMPLES] if given.folder is None else [given.folder]
    tables = [str(path) for path in found]

    first = night(tables, "cbrt", given.out / "cbrt")
    with (first / "summary.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            if row["error"]:
                print(f"  {row['table']}: {row['status']}, {row['error']} !")
                continue
            off = float(row["relative_rmse"] or "nan")  # a table of zeros has none
            mark = "" if off <= LOOK else " !"
            print(f"  {row['table']}, {row['model']}: {row['status']}, relative rmse {off:.3f}{mark}")

    second = night(tables, "log", given.out / "log")
    changes = batch.compare(first, second)
    print(f"under another metric {len(changes.changed)} figures differ beyond their uncertainties")


if __name__ == "__main__":
    main()
