"""Ctrl-C that can't get lost."""

from __future__ import annotations

import signal
import sys
from types import FrameType


class Interrupt:
    """Remembers that SIGINT came.

    Python raises KeyboardInterrupt wherever it is; where that is a callback of the compiler's, the exception
    is dropped there and the work would go on to its end.
    """

    def __init__(self) -> None:
        self._asked = False

    def install(self) -> None:
        """Take SIGINT over; in the main thread only."""
        signal.signal(signal.SIGINT, self._came)
        sys.unraisablehook = self._dropped

    def _dropped(self, dropped: sys.UnraisableHookArgs) -> None:
        """Say what was dropped where nobody could catch it; not that it was Ctrl-C, as :meth:`check` will."""
        if not (self._asked and isinstance(dropped.exc_value, KeyboardInterrupt)):
            sys.__unraisablehook__(dropped)

    def _came(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self._asked = True
        raise KeyboardInterrupt

    def check(self) -> None:
        """Raise KeyboardInterrupt if it came before."""
        if self._asked:
            raise KeyboardInterrupt
