"""A table larger than memory: written as Parquet, then checked and fitted out of core.

Not among the benchmarks that run by default, because of its size:

    python -m tests.bench.large FOLDER --samples 100000000

takes 40 bytes of disk a sample and prints a JSON document. The file is deleted afterwards.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from fitter.directions import spherical_from_vector
from tests.bench import plain, tables
from tests.bench.machine import describe
from tests.bench.measuring import load_average

SEED = 4
NOISE = 0.02
GROUP = 1_000_000
#: The child's own account: seconds of wall and processor, and VmHWM after each step.
_CODE = """
import json, os, re, sys, time
import fitter
from fitter.fitting import fit
path = sys.argv[1]
steps, clock = {}, [time.perf_counter(), time.process_time()]
def lap(name):
    now = [time.perf_counter(), time.process_time()]
    most = int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1])
    steps[name] = {"seconds": now[0] - clock[0], "cpu_seconds": now[1] - clock[1], "peak_bytes": 1024 * most}
    clock[:] = now
table = fitter.open_large(path)
lap("read once: counts, sums, weighted sample")
found = fitter.check(table)
lap("check: the sample judged, the file hashed")
result = fit(table, "ward", metric="cosine")
lap("fit")
print(json.dumps({
    "steps": steps, "verdict": found.verdict, "message": result.message, "status": result.status,
    "cost": result.cost, "samples": len(table), "sample": len(table.sample),
    "parameters": {
        n: [one.value.tolist(), one.standard_uncertainty.tolist()] for n, one in result.parameters.items()
    },
}))
"""


def make(path: Path, samples: int) -> None:
    """Write ``samples`` of the plain Ward model with 2 % noise.

    The directions are those of one group, turned about the normal for each further one: geometries differ,
    what an isotropic surface reflects doesn't, and only the noise is drawn anew.
    """
    import pyarrow
    from pyarrow import parquet

    size = min(samples, GROUP)
    wi, wo = tables.pairs(size, SEED)
    theta_i, phi_i, theta_o, phi_o = (angle for w in (wi, wo) for angle in spherical_from_vector(w))
    value = plain.evaluate("ward", wi, wo)[:, 0]
    names = ["theta_i_rad", "phi_i_rad", "theta_o_rad", "phi_o_rad", "brdf"]
    schema = pyarrow.schema([(name, pyarrow.float64()) for name in names], metadata={"symmetry": "isotropic"})
    rng = np.random.default_rng(SEED)
    with parquet.ParquetWriter(path, schema, compression="none", use_dictionary=False) as writer:
        for start in range(0, samples, size):
            n = min(size, samples - start)
            turn = 2 * np.pi * start / samples
            noisy = value[:n] * (1 + NOISE * rng.standard_normal(n))
            columns = [theta_i[:n], phi_i[:n] + turn, theta_o[:n], phi_o[:n] + turn, noisy]
            writer.write_table(pyarrow.table(dict(zip(names, columns, strict=True)), schema=schema))


def measure(path: Path) -> dict[str, Any]:
    """What :func:`fitter.open_large`, check and fit of the file at ``path`` take, in a process of its own."""
    before = load_average()
    done = subprocess.run(
        [sys.executable, "-c", _CODE, str(path)], capture_output=True, text=True, check=True
    )
    return {"load_average": [before, load_average()], "bytes": path.stat().st_size, **json.loads(done.stdout)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--samples", type=int, default=100_000_000)
    given = parser.parse_args()
    path = given.folder / f"large-{os.getpid()}.parquet"
    begun = time.perf_counter()
    try:
        make(path, given.samples)
        made = time.perf_counter() - begun
        print(json.dumps({"machine": describe(), "made_in_seconds": made, **measure(path)}, indent=2))
    finally:
        path.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
