"""The peak of the process's memory during a piece of work."""

from __future__ import annotations

import os
import resource
import sys
import threading
from pathlib import Path
from types import TracebackType
from typing import Self

_STATM = Path("/proc/self/statm")
#: Seconds between two looks.
EVERY = 0.005
_UNIT = 1 if sys.platform == "darwin" else 1024


class MemoryWatch:
    """Bytes resident at the start and at the peak, of the whole process.

    The system keeps a high-water mark that never falls. Where the work raised it, the peak is exact; where an
    earlier peak was higher, the memory is looked at every few milliseconds, and a shorter peak may be missed.
    """

    def __init__(self) -> None:
        self.before = resident()
        self.peak = self.before or 0
        self._mark = _high_water()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._look, name="memory-watch", daemon=True)

    def __enter__(self) -> Self:
        if self.before is not None:
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._done.set()
        if self.before is not None:
            self._thread.join()

    def read(self) -> tuple[int, int | None]:
        """(peak, growth) in bytes so far; no growth where the system does not tell what is resident."""
        mark = _high_water()
        now = resident()
        seen = max(self.peak, now or 0)
        peak = max(mark, seen) if mark > self._mark or now is None else seen
        return peak, None if self.before is None else max(0, peak - self.before)

    def _look(self) -> None:
        while not self._done.wait(EVERY):
            self.peak = max(self.peak, resident() or 0)


def resident() -> int | None:
    """Bytes of the process in memory now; None where the system does not say."""
    try:
        return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return None


def _high_water() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _UNIT
