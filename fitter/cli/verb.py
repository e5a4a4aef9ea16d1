"""Verb and Outcome: what one file of :mod:`fitter.cli.verbs` declares, and what it hands back."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fitter.cli.screen import Screen

#: Exit statuses, as README.md promises them.
DONE, WORK_FAILED, CALL_WRONG, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 130, 141


@dataclass(frozen=True)
class Outcome:
    """A finished verb: the document for ``--json``, the same for a person, and the exit status."""

    document: Mapping[str, Any]
    show: Callable[[Screen], None]
    status: int = DONE


@dataclass(frozen=True)
class Verb:
    """One verb. Its module imports nothing heavy: that waits until ``configure`` or ``run`` is called.

    configure : adds the verb's arguments; called only for the verb that was asked for.
    run : does the work. Raises FitterError. None where the verb has already printed its document.
    epilog : text below the options in ``--help``, made only when the help is shown.
    """

    summary: str
    configure: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace, Screen], Outcome | None]
    epilog: Callable[[], str] | None = None
