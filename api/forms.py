"""Forms: the one file of a multipart body, handed on while it arrives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from api.problems import Problem

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks

#: What a part's headers may be long.
MAX_HEADER = 8192


class FileForm:
    """A ``multipart/form-data`` body with exactly one part, ``file``; its bytes go to ``sink`` in order.

    The framework's own form parsing writes each file to the disk once more before anybody sees it.

    Raises
    ------
    Problem : 400 where the framing is broken, 422 where the form holds something else.
    """

    def __init__(self, content_type: str, sink: Callable[[bytes], None]) -> None:
        _, options = parse_options_header(content_type)
        boundary = options.get(b"boundary", b"")
        if not boundary:
            raise _broken("the content type names no boundary")
        self._sink = sink
        self._field = self._value = b""
        self._headers: dict[bytes, bytes] = {}
        self._parts = 0
        self._complete = False
        self.filename: str | None = None
        callbacks: MultipartCallbacks = {
            "on_part_begin": self._part_begins, "on_part_data": self._part_data,
            "on_header_field": self._header_field, "on_header_value": self._header_value,
            "on_header_end": self._header_ends, "on_headers_finished": self._headers_end,
            "on_end": self._ends,
        }  # fmt: skip
        try:
            self._parser = MultipartParser(boundary, callbacks)
        except FormParserError as error:
            raise _broken(str(error)) from error

    def write(self, chunk: bytes) -> None:
        """The next piece of the body."""
        try:
            self._parser.write(chunk)
        except FormParserError as error:
            raise _broken(str(error)) from error

    def finish(self) -> None:
        """The body has ended: so must have the form."""
        if not self._complete:
            raise _broken("the body ends before the form does")
        if self._parts == 0:
            raise _not_one_file()

    def _part_begins(self) -> None:
        self._parts += 1
        if self._parts > 1:
            raise _not_one_file()

    def _header_field(self, data: bytes, start: int, end: int) -> None:
        self._field += data[start:end]
        self._bounded()

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]
        self._bounded()

    def _bounded(self) -> None:
        if len(self._field) + len(self._value) > MAX_HEADER or len(self._headers) > 32:
            raise _broken("the header of the form's part is too long")

    def _header_ends(self) -> None:
        self._headers[self._field.lower()] = self._value
        self._field = self._value = b""

    def _headers_end(self) -> None:
        _, options = parse_options_header(self._headers.get(b"content-disposition", b""))
        if options.get(b"name") != b"file":
            raise _not_one_file()
        self.filename = _label(options)

    def _part_data(self, data: bytes, start: int, end: int) -> None:
        self._sink(data[start:end])

    def _ends(self) -> None:
        self._complete = True


def _label(options: Mapping[bytes, bytes]) -> str | None:
    """The last part of the file's name, printable, for people; it never becomes a path."""
    given = options.get(b"filename", b"").decode("utf-8", "replace").replace("\\", "/").split("/")[-1]
    return "".join(c for c in given if c.isprintable())[:200] or None


def _broken(detail: str) -> Problem:
    return Problem(
        400, "bad-form", f"the form can't be read: {detail}",
        remedy="send it whole, as multipart/form-data with a boundary",
    )  # fmt: skip


def _not_one_file() -> Problem:
    return Problem.invalid(
        "bad-form", "the form does not hold exactly one field, `file`", parameter="file",
        remedy="send the table as `file`, and reading options as query parameters",
    )  # fmt: skip
