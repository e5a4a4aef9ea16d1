"""Logs: one JSON object a line on standard error, or plain lines where that is a terminal.

Lines written while a request is answered name it (``request``), and who asked (``key``).
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping
from contextvars import ContextVar
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any

from api.problems import encoded

#: What the lines of this request have in common.
_CONTEXT: ContextVar[Mapping[str, Any]] = ContextVar("log_context", default=MappingProxyType({}))
#: What a record holds besides what ``extra`` gave it.
_PLAIN = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName", "color_message"}


def naming(**fields: Any) -> None:
    """Have the lines of this request say this, too."""
    _CONTEXT.set({**_CONTEXT.get(), **fields})


class JsonLines(logging.Formatter):
    """A record as one line of JSON; what ``extra`` gave it are members of their own."""

    def format(self, record: logging.LogRecord) -> str:
        when = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        line: dict[str, Any] = {
            "time": when.replace("+00:00", "Z"), "level": record.levelname.lower(), "logger": record.name,
            "message": record.getMessage(), **_CONTEXT.get(),
        }  # fmt: skip
        line |= {name: value for name, value in vars(record).items() if name not in _PLAIN}
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return encoded(line).decode()


class Lines(logging.Formatter):
    """A record for a person's eyes."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)-7s %(message)s", "%H:%M:%S")

    def format(self, record: logging.LogRecord) -> str:
        more = {name: value for name, value in vars(record).items() if name not in _PLAIN}
        return " ".join([super().format(record), *(f"{name}={value}" for name, value in more.items())])


def configure(level: str) -> None:
    """Have this process's loggers write to standard error; for a process that is a server."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(Lines() if sys.stderr.isatty() else JsonLines())
    for name in ("brdf_fitter", "uvicorn"):
        logger = logging.getLogger(name)
        logger.handlers, logger.propagate = [handler], False
        logger.setLevel(level.upper())
