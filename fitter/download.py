"""Downloads over HTTP that survive a cut: written aside, resumed, checked, renamed.

What has come is kept in ``.NAME.part`` beside the target, with the server's validator in ``.NAME.part.json``.
The next try asks for the rest on condition that the file is still the same (RFC 9110: Range, If-Range).
"""

from __future__ import annotations

import hashlib
import http.client
import json
import os
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from email.message import Message
from pathlib import Path
from typing import Any, BinaryIO, cast
from urllib.parse import urlsplit

from fitter._version import __version__
from fitter.errors import FitError, SpecError
from fitter.progress import Progress, ignore

CHUNK = 1 << 16
#: Seconds without a byte after which a connection counts as dead.
TIMEOUT = 30.0
#: Tries in a row that bring nothing new, and the longest wait between them (seconds).
TRIES, LONGEST_WAIT = 5, 30.0
#: Answers that may be others a moment later.
_PASSING = frozenset({408, 425, 429, 500, 502, 503, 504})


class _Cut(Exception):
    """The connection ended early, or the server asked to come again: worth another try."""

    def __init__(self, reason: str, wait: float | None = None) -> None:
        super().__init__(reason)
        self.wait = wait


@dataclass
class _Part:
    """What has come so far, and the validator it came with (None: it can't be resumed)."""

    data: Path
    notes: Path
    url: str

    def held(self) -> tuple[int, str | None]:
        """Bytes that can be kept, and the validator to ask with."""
        try:
            said = json.loads(self.notes.read_bytes())
            size = self.data.stat().st_size
        except (OSError, ValueError):
            return 0, None
        same = isinstance(said, dict) and cast("dict[str, Any]", said).get("url") == self.url
        validator = cast("dict[str, Any]", said).get("validator") if same else None
        return (size, validator) if isinstance(validator, str) else (0, None)

    def begin(self, validator: str | None) -> None:
        self.notes.write_text(json.dumps({"url": self.url, "validator": validator}), encoding="utf-8")

    def drop(self) -> None:
        self.data.unlink(missing_ok=True)
        self.notes.unlink(missing_ok=True)


def existing(path: Path, *, sha256: str | None = None, size: int | None = None) -> tuple[int, str] | None:
    """``(bytes, sha256)`` of the file that is there already, None where there is none.

    Raises FitError where it is not what was expected: it is somebody's file, and stays.
    """
    if not path.exists():
        return None
    digest = _digest(path)
    found = path.stat().st_size
    wrong = _difference(found, digest, sha256, size)
    if wrong:
        raise FitError(
            f"the file that is there {wrong}", code="download-differs", file=str(path),
            cause="it is another file, or was cut off", remedy="move or delete it, or choose another folder",
        )  # fmt: skip
    return found, digest


def download(
    url: str, path: Path, *, sha256: str | None = None, size: int | None = None,
    progress: Progress = ignore, pause: Callable[[float], None] = time.sleep,
) -> tuple[int, str]:  # fmt: skip
    """Fetch ``url`` to ``path``; ``(bytes, sha256)`` of what came.

    sha256, size : what the file must have. pause : waits so many seconds between tries.

    Raises
    ------
    SpecError : the address is none of http or https.
    FitError : the server refuses (at once), the connection fails again and again, the disk is full, or the
        file is not the expected one. But for the last, what has come stays for the next call.
    """
    if not _usable(url):
        raise SpecError(
            f"{url!r} is no address to download from", code="bad-address", parameter="from",
            remedy="give one that begins with https:// or http://, its spaces and accents as %20 and so on",
        )  # fmt: skip
    part = _Part(path.with_name(f".{path.name}.part"), path.with_name(f".{path.name}.part.json"), url)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        resumed = _fetch(part, progress, pause)
        digest, found = _digest(part.data), part.data.stat().st_size
        wrong = _difference(found, digest, sha256, size)
        if wrong and resumed:
            # Two versions may have been joined by a server that does not keep its promises.
            part.drop()
            _fetch(part, progress, pause)
            digest, found = _digest(part.data), part.data.stat().st_size
            wrong = _difference(found, digest, sha256, size)
        if wrong:
            part.drop()
            raise FitError(
                f"what {_shown(url)} sent {wrong}", code="download-differs", file=path.name,
                cause="the file has changed, or the server sent another page in its place",
                remedy="look at the address in a browser; nothing was kept",
            )  # fmt: skip
        part.data.replace(path)
        part.notes.unlink(missing_ok=True)
    except OSError as error:
        raise FitError(
            f"the download can't be written: {error.strerror or error}", code="download-not-written",
            file=str(path), cause="the disk is full, or the folder can't be written to",
            remedy="make room and start it again: it goes on where it stopped",
        ) from error  # fmt: skip
    return found, digest


def _fetch(part: _Part, progress: Progress, pause: Callable[[float], None]) -> bool:
    """Bring the whole file into the part; whether any of it is of an earlier connection."""
    failures, resumed, before = 0, False, part.held()[0]
    while True:
        try:
            return _once(part, progress) or resumed
        except _Cut as cut:
            held = part.held()[0]
            failures = 1 if held > before else failures + 1
            resumed, before = resumed or held > 0, held
            if failures >= TRIES:
                raise FitError(
                    f"the download from {_shown(part.url)} failed {failures} times in a row: {cut}",
                    code="download-failed", file=part.data.name.removeprefix(".").removesuffix(".part"),
                    cause="the server or the network is down",
                    remedy="start it again later: it goes on where it stopped",
                ) from cut  # fmt: skip
            wait = 2.0 ** (failures - 1) if cut.wait is None else cut.wait
            progress(0.0, f"waiting to try again: {cut}")
            pause(min(wait, LONGEST_WAIT))


def _once(part: _Part, progress: Progress) -> bool:
    """One connection; whether it went on from bytes that were there. Raises _Cut where it ended early."""
    held, validator = part.held()
    headers = {"User-Agent": f"brdf-fitter/{__version__}", "Accept-Encoding": "identity"}
    if held and validator:
        headers |= {"Range": f"bytes={held}-", "If-Range": validator}
    try:
        answer = _opener().open(urllib.request.Request(part.url, headers=headers), timeout=TIMEOUT)
    except urllib.error.HTTPError as error:
        with error:
            if error.code == 416 and held:
                part.drop()  # what is there is no beginning of what the server has
                raise _Cut("the server has no more of the file") from error
            if error.code in _PASSING:
                raise _Cut(f"the server said {error.code} {error.reason}", _wait(error.headers)) from error
            raise FitError(
                f"the server refused {_shown(part.url)}: {error.code} {error.reason}",
                code="download-refused",
                cause=_REFUSED.get(error.code, "the address is wrong, or needs a login"),
                remedy="look at the database's page for the present address and name it with --from",
            ) from error  # fmt: skip
    except (urllib.error.URLError, http.client.HTTPException, OSError) as error:
        raise _Cut(f"no connection ({getattr(error, 'reason', None) or error})") from error
    with answer:
        said = cast("Message", answer.headers)
        start, total = _place(answer.status, said, held)
        if said.get_content_type() in ("text/html", "application/xhtml+xml"):
            raise FitError(
                f"{_shown(part.url)} is a web page, not a file", code="download-refused",
                cause="a login, an error page, or a page that links the file",
                remedy="open it in a browser; name the file's own address with --from",
            )  # fmt: skip
        with part.data.open("r+b" if start else "wb") as file:
            file.seek(start)
            if start == 0:
                part.begin(_validator(said))  # once the old bytes are gone: they are not of this version
            _copy(answer, file, start, total, progress)
            file.flush()
            os.fsync(file.fileno())
    return start > 0


def _copy(answer: Any, file: BinaryIO, start: int, total: int | None, progress: Progress) -> None:
    at = start
    while True:
        try:
            chunk = cast("bytes", answer.read1(CHUNK))
        except (http.client.HTTPException, OSError) as error:
            raise _Cut(f"the connection was cut at byte {at:,}") from error
        if not chunk:
            break
        file.write(chunk)
        at += len(chunk)
        of = f" of {total / 1e6:.1f}" if total else ""
        progress(at / total if total else 0.0, f"{at / 1e6:.1f}{of} MB")
    if total is not None and at < total:
        raise _Cut(f"the connection was cut at byte {at:,} of {total:,}")


def _place(status: int, said: Message, held: int) -> tuple[int, int | None]:
    """``(first byte, total)`` of the answer's body. Raises _Cut where it is not what was asked for."""
    if status == 206:
        unit, _, rest = said.get("Content-Range", "").partition(" ")
        span, _, total = rest.partition("/")
        if unit == "bytes" and span.partition("-")[0] == str(held):
            return held, int(total) if total.isdecimal() else None
        raise _Cut("the server sent another part than the one that was asked for")
    length = said.get("Content-Length", "")
    return 0, int(length) if length.isdecimal() else None


def _validator(said: Message) -> str | None:
    """What proves later that the file is the same: a strong ETag, else its date."""
    tag = said.get("ETag")
    return tag if tag and not tag.startswith("W/") else said.get("Last-Modified")


def _wait(said: Message) -> float | None:
    stated = said.get("Retry-After", "")
    return float(stated) if stated.isdecimal() else None


def _opener() -> urllib.request.OpenerDirector:
    """http and https alone, redirected or not: an address must not name a file of this machine."""
    opener = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.ProxyHandler, urllib.request.HTTPHandler, urllib.request.HTTPSHandler,
        urllib.request.HTTPRedirectHandler, urllib.request.HTTPDefaultErrorHandler,
        urllib.request.HTTPErrorProcessor, urllib.request.UnknownHandler,
    ):  # fmt: skip
        opener.add_handler(handler())
    return opener


_REFUSED = {
    401: "the file needs a login", 403: "the file needs a login or is not public",
    404: "the file is not at this address any more", 410: "the file is not at this address any more",
}  # fmt: skip


def _difference(found: int, digest: str, sha256: str | None, size: int | None) -> str:
    """What is wrong with a file of these facts, "" where nothing is."""
    if size is not None and found != size:
        return f"has {found:,} bytes, and {size:,} were expected"
    if sha256 is not None and digest != sha256:
        return f"has the sha256 {digest}, and {sha256} was expected"
    return ""


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _usable(url: str) -> bool:
    try:
        parts = urlsplit(url)
        named = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:  # a port that is none
        return False
    return named and url.isascii() and url.isprintable() and " " not in url


def _shown(url: str) -> str:
    """The address without what may be secret in it."""
    parts = urlsplit(url)
    return f"{parts.scheme}://{parts.hostname}{f':{parts.port}' if parts.port else ''}{parts.path}"
