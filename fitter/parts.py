"""Work on long arrays in parts: what is computed on the way stays in the cache, and cores share the parts."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context

#: Rows of a part.
ROWS = 1 << 13
#: Threads take turns on fewer rows than this more slowly than one alone works through them.
_MANY = 1 << 20
_THREADS = 4


def in_parts(work: Callable[[slice], None], count: int, rows: int | None = None, many: int = _MANY) -> None:
    """Call ``work`` with slices that cover ``range(count)``, in any order, from several threads where many.

    rows : of a slice; default ``ROWS``. many : rows from which on there are threads; fewer are worth it where
    ``work`` holds no lock.

    ``work`` writes what it computes into arrays of its caller, at its slice. What it raises is raised here.
    """
    rows = rows or ROWS
    slices = [slice(start, min(start + rows, count)) for start in range(0, count, rows)]
    threads = min(os.cpu_count() or 1, _THREADS)
    if count < many or threads == 1:
        for part in slices:
            work(part)
        return

    def share(first: int) -> None:
        for part in slices[first::threads]:
            work(part)

    with ThreadPoolExecutor(threads) as pool:
        # Each in the caller's context: NumPy keeps there what it does about overflow.
        for done in [pool.submit(copy_context().run, share, k) for k in range(threads)]:
            done.result()
