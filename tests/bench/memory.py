"""The most memory a call holds at a time, measured in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

#: Both figures are VmHWM, which begins anew with each program; ru_maxrss begins with its parent's.
_CODE = """
import re, sys
{setup}
def most():
    return 1024 * int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1])
before = most()
held = {call}
print(most() - before)
"""


def peak(setup: str, call: str, path: Path) -> int | None:
    """Bytes that ``call``, an expression in ``path``, needed at most after ``setup``; None if none tells."""
    if not Path("/proc/self/status").exists():
        return None
    code = _CODE.format(setup=setup, call=call)
    done = subprocess.run(
        [sys.executable, "-c", f"from pathlib import Path\npath = Path(r'{path}')\n{code}"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return int(done.stdout)


def ours(path: Path) -> int | None:
    """Bytes that :func:`fitter.load` needed at most, its libraries loaded beforehand."""
    setup = "import fitter, fitter.formats, pyarrow.csv, pyarrow.parquet\nfitter.formats.formats()"
    return peak(setup, "fitter.load(path)", path)
