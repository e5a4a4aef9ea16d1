"""``python -m tests.evidence [MODELS...]``: run the long studies; exit status 1 on any violation."""

from __future__ import annotations

import argparse
import json
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path

from fitter.documents import write_bytes
from fitter.errors import FitterError
from fitter.spec import model_spec
from tests.evidence import page
from tests.evidence.running import merged, run
from tests.evidence.study import studies

ROOT = Path(__file__).resolve().parents[2]
SEED = 20_250


def main(words: Sequence[str] | None = None) -> int:
    known = studies()
    parser = argparse.ArgumentParser(prog="python -m tests.evidence", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="MODEL", help="short names (default: all of the suite)")
    parser.add_argument("--study", action="append", choices=known, help="only this one")
    parser.add_argument("--share", type=float, default=1.0, help="of the points of a full run")
    parser.add_argument("--seed", default=str(SEED), help="a number, or fresh (default: %(default)s)")
    parser.add_argument(
        "--write", action="store_true",
        help="write docs/evidence.json and docs/evidence.md, where studies that were not run stay",
    )  # fmt: skip
    given = parser.parse_args(words)
    if given.write and given.names:
        parser.error("--write takes whole studies: leave MODEL out")
    seed = secrets.randbelow(2**32) if given.seed == "fresh" else int(given.seed)
    try:
        names = [model_spec(name).name for name in given.names]
    except FitterError as error:
        print(error, file=sys.stderr)
        return 2
    chosen = [known[name] for name in given.study or known]
    document = run(chosen, names, given.share, seed)
    print("\n".join(page.lines(document)))
    if given.write:
        path = ROOT / "docs" / "evidence.json"
        whole = merged(json.loads(path.read_text()), document) if path.exists() else document
        write_bytes((json.dumps(whole, indent=1) + "\n").encode(), path)
        write_bytes("\n".join([*page.head(), *page.lines(whole)]).encode(), path.with_suffix(".md"))
    # Once more and last: of a long log the end is what is kept.
    broken = [
        f"{study['name']}: {row['model']}: {one}"
        for study in document["studies"] for row in study["rows"] for one in row["violations"]
    ]  # fmt: skip
    print("", *broken, sep="\n", file=sys.stderr)
    print(f"seed {seed}: {len(broken) or 'no'} violation(s)", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
