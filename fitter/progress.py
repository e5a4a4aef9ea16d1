"""Progress: how long work tells a person, a job row or nobody how far it is, and can be stopped."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from fitter.errors import FitError

#: Called with (share done in [0, 1], what is being done). It may raise :class:`Cancelled`.
Progress: TypeAlias = Callable[[float, str], None]


class Cancelled(FitError):
    """Raised out of a progress callback to stop the work at its next safe point."""

    def __init__(self) -> None:
        super().__init__("the work was cancelled", code="cancelled")


def ignore(done: float, what: str) -> None:
    """The progress callback of a caller that does not care."""
    del done, what
