"""The errors a caller can act on: what happened, where, the likely cause and the remedy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class FitterError(Exception):
    """Base of every error this library raises on purpose.

    Parameters
    ----------
    message : what happened, one sentence.
    code : a stable slug (``table-empty``), the last part of the problem document's ``type``.
    file, row, column, offset, parameter : where. ``row`` counts from 1 as an editor does; ``column`` is a
        field, variable or header line, too; ``offset`` is a byte of a binary file, from 0.
    cause, remedy : the likely cause and what to do about it, one sentence each.
    """

    def __init__(
        self,
        message: str,
        *,
        code: str,
        file: str | None = None,
        row: int | None = None,
        column: str | None = None,
        offset: int | None = None,
        parameter: str | None = None,
        cause: str | None = None,
        remedy: str | None = None,
    ) -> None:
        self.message = message
        self.code = code
        self.file = file
        self.row = row
        self.column = column
        self.offset = offset
        self.parameter = parameter
        self.cause = cause
        self.remedy = remedy
        super().__init__(str(self))

    def where(self) -> dict[str, str | int]:
        """The place, as a JSON-ready mapping that holds only what is known."""
        place: dict[str, str | int | None] = {
            "file": self.file, "row": self.row, "column": self.column, "offset": self.offset,
            "parameter": self.parameter,
        }  # fmt: skip
        return {key: item for key, item in place.items() if item is not None}

    def to_dict(self) -> dict[str, object]:
        """JSON-ready form, shared by ``--json`` and the HTTP problem documents."""
        document: dict[str, object] = {"code": self.code, "message": self.message, **self.where()}
        if self.cause:
            document["cause"] = self.cause
        if self.remedy:
            document["remedy"] = self.remedy
        return document

    def __str__(self) -> str:
        place = ", ".join(f"{key} {item}" for key, item in self.where().items())
        parts = [f"{place}: {self.message}" if place else self.message]
        if self.cause:
            parts.append(f"Likely cause: {self.cause}")
        if self.remedy:
            parts.append(f"Remedy: {self.remedy}")
        return " ".join(part if part.endswith((".", "?", "!")) else part + "." for part in parts)

    def __reduce__(self) -> tuple[object, ...]:
        # Keyword-only arguments: the default would lose them between processes.
        return (_rebuild, (type(self), self.message, self.__dict__.copy()))


def _rebuild(kind: type[FitterError], message: str, state: dict[str, object]) -> FitterError:
    error = kind.__new__(kind)
    Exception.__init__(error, message)
    error.__dict__.update(state)
    return error


class TableError(FitterError):
    """A file or table that can't be used as it is (exit status 2, HTTP 4xx)."""


class NoTable(TableError):
    """A file that was understood and holds no BRDF, as one of transmission.

    contents : what it holds instead, JSON-ready: ``holds`` says it in words, the rest is the format's.
    """

    def __init__(self, message: str, *, code: str, contents: Mapping[str, Any], **where: Any) -> None:
        self.contents = contents
        super().__init__(message, code=code, **where)

    def to_dict(self) -> dict[str, object]:
        """As of any error, and the contents."""
        return {**super().to_dict(), "contents": dict(self.contents)}


class SpecError(FitterError):
    """A request that makes no sense: an unknown model, a bound the wrong way round (exit 2, HTTP 4xx)."""


class FitError(FitterError):
    """The work itself failed on valid input (exit status 1, a failed job)."""
