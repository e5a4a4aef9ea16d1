"""A process of its own: ``python -m tests.bench.cold TABLE CACHE`` loads a table, fits it, prints seconds."""

from __future__ import annotations

import itertools
import json
import sys
import time
from pathlib import Path


def main(table: str, cache: str) -> None:
    laps = [time.perf_counter()]
    import fitter
    from fitter._jax import compile_sooner, use_compilation_cache

    # As the command starts.
    compile_sooner()
    use_compilation_cache(Path(cache))
    import fitter.fitting

    laps.append(time.perf_counter())
    loaded = fitter.load(table)
    laps.append(time.perf_counter())
    for _ in range(2):
        fitter.fit(loaded, "ward")
        laps.append(time.perf_counter())
    seconds = [b - a for a, b in itertools.pairwise(laps)]
    print(json.dumps(dict(zip(("import", "load", "fit", "fit_again"), seconds, strict=True))))


if __name__ == "__main__":
    main(*sys.argv[1:])
