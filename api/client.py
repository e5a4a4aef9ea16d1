"""Client: the service from Python. Tests and ``brdf-fitter --server`` use it.

    with Client("http://127.0.0.1:8000") as client:
        table = client.upload("paint.astm")
        job = client.wait(client.start("fits", table=table.id, model="ward"))
        fit = client.fit(job.results[0]["id"])

What the service refuses is :class:`Refused`, what it fails to do :class:`ServiceFailed`.
"""

from __future__ import annotations

import io
import time
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal, Self, TypeVar, cast

import httpx
import numpy as np
import orjson
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel

from api.schemas import JobDocument, ModelDocument, TableDocument
from api.states import FINAL
from fitter.errors import FitError, FitterError, SpecError
from fitter.progress import Cancelled, Progress, ignore

_D = TypeVar("_D", bound=BaseModel)
Document = dict[str, Any]
#: What can be started, as the paths name it.
Work = Literal["fits", "posteriors", "calibrations", "tradeoffs"]

NPY = "application/x-npy"
#: Seconds before each further attempt at a request that did not reach the server.
RETRY_AFTER = (0.2, 1.0, 3.0)
#: Seconds that an earlier attempt at the request may still be worked on: a server that was killed meanwhile
#: has the request's name for 30 s more.
IN_FLIGHT = 60.0
#: Seconds without a byte (the server sends one every 15) after which an event stream counts as lost.
SILENCE = 45.0


#: What another attempt does not mend: a URL that is none, and a server too slow for the caller.
_FINAL = (httpx.UnsupportedProtocol, httpx.TimeoutException)
_NO_RANGES = {
    "code": "range-not-answered", "detail": "the rest of a download that was cut off can't be had",
    "cause": "something between here and the server does not pass ranges on",
    "remedy": "try again, or ask the server itself",
}  # fmt: skip


class Refused(FitterError):
    """The service refused a request (4xx): ``status``, and the whole problem ``document``."""

    def __init__(self, status: int, document: Mapping[str, Any]) -> None:
        self.status, self.document = status, dict(document)
        super().__init__(**_fields(document))


class ServiceFailed(FitError):
    """The service failed (5xx), or can't be reached (``status`` None), or a job failed."""

    def __init__(self, status: int | None, document: Mapping[str, Any]) -> None:
        self.status, self.document = status, dict(document)
        super().__init__(**_fields(document))


class Client:
    """One service.

    key : an API key, where the service asks for one.
    timeout : seconds that the server may stay silent within one answer.
    http : the HTTP client to use instead of one made from ``url``; the caller closes it.

    Raises Refused and ServiceFailed. Requests that are cut off, or 503, are sent again a few times, those of
    which an earlier attempt is still worked on until that has ended: what a POST makes is made once all the
    same (``Idempotency-Key``).
    """

    def __init__(
        self, url: str = "", *, key: str | None = None, timeout: float = 120.0,
        http: httpx.Client | None = None,
    ) -> None:  # fmt: skip
        self._own = http is None
        if http is None and not url.startswith(("http://", "https://")):
            raise SpecError(
                f"{url!r} is no URL of a service", code="bad-url", parameter="server",
                remedy="give http://HOST:PORT",
            )  # fmt: skip
        self._http = http or httpx.Client(base_url=url, timeout=timeout)
        self._headers = {} if key is None else {"Authorization": f"Bearer {key}"}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        if self._own:
            self._http.close()

    # Tables -----------------------------------------------------------------------------------------

    def upload(self, source: str | Path | bytes | IO[bytes], **options: Any) -> TableDocument:
        """Send a measured table: a file's path, its bytes or an open file, which is streamed.

        ``options`` are those of :func:`fitter.load`. A path's last part is the table's name unless another
        is given.
        """
        if isinstance(source, str | Path):
            options.setdefault("name", Path(source).name[:200])
            try:
                with Path(source).open("rb") as file:
                    return self.upload(file, **options)
            except OSError as error:
                raise SpecError(
                    f"can't be read: {error.strerror}", code="file-unreadable", file=str(source),
                    remedy="give one file; a folder goes as a zip archive",
                ) from error  # fmt: skip
        answer = self.request("POST", "/v1/tables", content=source, params=_options(options))
        return TableDocument.model_validate_json(answer.content)

    def read_again(self, id: str, **options: Any) -> TableDocument:
        """Another table from the same bytes, read with other options."""
        answer = self.request("POST", f"/v1/tables/{id}/readings", params=_options(options))
        return TableDocument.model_validate_json(answer.content)

    def table(self, id: str) -> TableDocument:
        return self._get(f"/v1/tables/{id}", TableDocument)

    def content(self, id: str) -> Iterator[bytes]:
        """The bytes that were uploaded as this table, in pieces as they come; a lost stream is taken up again
        where it broke off."""
        at, waits = 0, list(RETRY_AFTER)
        while True:
            # As they are: packed on the way, a range would be one of something else.
            headers = {**self._headers, "Range": f"bytes={at}-", "Accept-Encoding": "identity"}
            try:
                with self._http.stream("GET", f"/v1/tables/{id}/content", headers=headers) as answer:
                    if answer.status_code != 503 or not waits:
                        if at and answer.headers.get("content-range") == f"bytes */{at}":
                            return  # lost after the last byte
                        if answer.status_code >= 400:
                            answer.read()
                            raise _error(answer)
                        if at and not answer.headers.get("content-range", "").startswith(f"bytes {at}-"):
                            raise ServiceFailed(answer.status_code, _NO_RANGES)
                        for piece in answer.iter_raw():
                            at += len(piece)
                            yield piece
                        return
            except httpx.TransportError as error:
                if not waits or isinstance(error, _FINAL):
                    raise _unreachable(error) from error
            time.sleep(waits.pop(0))

    def tables(self) -> Iterator[TableDocument]:
        """All tables, newest first."""
        return self.pages("/v1/tables", TableDocument)

    def delete_table(self, id: str) -> None:
        self.request("DELETE", f"/v1/tables/{id}")

    def check(self, id: str, seed: int = 0) -> Document:
        """What is known of a table's quality."""
        return self.document(f"/v1/tables/{id}/check", seed=seed)

    # Jobs -------------------------------------------------------------------------------------------

    def start(self, work: Work, **wanted: Any) -> JobDocument:
        """Start a job: ``start("fits", table=ID, model="ward")``."""
        answer = self.request("POST", f"/v1/{work}", json=wanted)
        return JobDocument.model_validate_json(answer.content)

    def job(self, id: str) -> JobDocument:
        return self._get(f"/v1/jobs/{id}", JobDocument)

    def cancel(self, id: str) -> JobDocument:
        answer = self.request("POST", f"/v1/jobs/{id}/cancel")
        return JobDocument.model_validate_json(answer.content)

    def wait(self, job: JobDocument | str, progress: Progress = ignore) -> JobDocument:
        """The job once it is done, followed by its events; a lost stream is taken up again.

        Raises ServiceFailed where the job failed, FitError where it was cancelled. What ``progress`` raises
        (as KeyboardInterrupt) cancels the job.
        """
        id = job if isinstance(job, str) else job.id
        seen: str | None = None
        try:
            while (found := self.job(id)).state not in FINAL:
                progress(found.progress.share, found.progress.what)
                seen = self._follow(id, seen, progress)
        except (Cancelled, KeyboardInterrupt):
            self.cancel(id)
            raise
        if found.state == "failed":
            raise ServiceFailed(None, found.problem or {})
        if found.state == "cancelled":
            raise FitError("the job was cancelled", code="cancelled")
        return found

    def _follow(self, id: str, seen: str | None, progress: Progress) -> str | None:
        """Report events until the stream ends; the id of the last one."""
        headers = {**self._headers, "Accept": "text/event-stream"}
        if seen is not None:
            headers["Last-Event-ID"] = seen
        try:
            with self._http.stream(
                "GET", f"/v1/jobs/{id}/events", headers=headers, timeout=httpx.Timeout(SILENCE)
            ) as stream:
                if stream.status_code >= 400:
                    stream.read()
                    raise _error(stream)
                for line in stream.iter_lines():
                    name, _, value = line.partition(":")
                    if name == "id":
                        seen = value.strip()
                    elif name == "data":
                        told = orjson.loads(value)
                        told = told.get("progress", told)
                        progress(float(told["share"]), str(told["what"]))
        except httpx.TransportError:
            time.sleep(RETRY_AFTER[0])  # the look at the job that follows says whether the server is there
        return seen

    # Results ----------------------------------------------------------------------------------------

    def fit(self, id: str) -> Document:
        """The whole fit: ``FitResult.from_dict`` takes it."""
        return self.document(f"/v1/fits/{id}")

    def posterior(self, id: str) -> Document:
        """The whole posterior: ``Posterior.from_dict`` takes it."""
        return self.document(f"/v1/posteriors/{id}")

    def report(self, fit: str, kind: Literal["html", "json", "pdf"] = "html") -> bytes:
        return self.request("GET", f"/v1/fits/{fit}/report.{kind}").content

    def model(self, id: str) -> ModelDocument:
        return self._get(f"/v1/models/{id}", ModelDocument)

    def create_model(self, model: str, **values: Any) -> ModelDocument:
        """Keep a model whose parameters were made elsewhere."""
        answer = self.request("POST", "/v1/models", json={"model": model, "values": values})
        return ModelDocument.model_validate_json(answer.content)

    def evaluate(
        self, of: Literal["models", "tables"], id: str, wi: ArrayLike, wo: ArrayLike
    ) -> NDArray[Any]:
        """f_r without the cosine, 1/sr, at pairs (M, 3): (M, C) of a model; of a table a structured array
        with the fields ``value`` (C,) and ``extrapolated``."""
        pairs = np.stack([np.asarray(w, dtype=np.float64) for w in np.broadcast_arrays(wi, wo)])
        sent = io.BytesIO()
        np.save(sent, pairs, allow_pickle=False)
        return self.arrays(f"/v1/{of}/{id}/evaluate", sent.getvalue(), NPY)[0]

    def sample(
        self, of: Literal["models", "tables"], id: str, **wanted: Any
    ) -> tuple[NDArray[Any], httpx.Headers]:
        """Draws as a structured array, and the headers with acceptance, evaluations and seed."""
        verb = "sample" if of == "models" else "samples"
        return self.arrays(f"/v1/{of}/{id}/{verb}", orjson.dumps(wanted), "application/json")

    # Any request ------------------------------------------------------------------------------------

    def document(self, path: str, **params: Any) -> Document:
        """The JSON object at ``path``."""
        found = orjson.loads(self.request("GET", path, params=params).content)
        return cast("Document", found)

    def pages(self, path: str, kind: type[_D]) -> Iterator[_D]:
        """The items of a list, page after page, as the header Link leads."""
        following: str | None = path
        while following is not None:
            answer = self.request("GET", following)
            for item in orjson.loads(answer.content)["items"]:
                yield kind.model_validate(item)
            following = answer.links.get("next", {}).get("url")

    def arrays(self, path: str, body: bytes, kind: str) -> tuple[NDArray[Any], httpx.Headers]:
        """POST ``body``; the answer's array and its headers."""
        headers = {"Content-Type": kind, "Accept": NPY}
        answer = self.request("POST", path, content=body, headers=headers)
        return np.load(io.BytesIO(answer.content), allow_pickle=False), answer.headers

    def request(
        self, method: str, path: str, *, headers: Mapping[str, str] | None = None, **more: Any
    ) -> httpx.Response:
        """One request, sent again while the server does not answer. Raises Refused or ServiceFailed."""
        sent = {**self._headers, **(headers or {})}
        if method == "POST":
            sent["Idempotency-Key"] = uuid.uuid4().hex
        answer = self._answer(method, path, sent, more)
        if answer.status_code >= 400:
            raise _error(answer)
        return answer

    def _answer(
        self, method: str, path: str, headers: Mapping[str, str], more: Mapping[str, Any]
    ) -> httpx.Response:
        body = more.get("content")
        start = 0 if body is None or isinstance(body, bytes) else body.tell()
        waits, end = list(RETRY_AFTER), time.monotonic() + IN_FLIGHT
        while True:
            try:
                answer = self._http.request(method, path, headers=headers, **more)
            except httpx.TransportError as error:
                if not waits or isinstance(error, _FINAL):
                    raise _unreachable(error) from error
                time.sleep(waits.pop(0))
            else:
                # Of all conflicts only that with an earlier attempt at a request says when to try again.
                again = answer.headers.get("retry-after") if answer.status_code == 409 else None
                if again is not None and time.monotonic() < end:
                    time.sleep(float(again))
                elif answer.status_code == 503 and waits:
                    time.sleep(waits.pop(0))
                else:
                    return answer
            if body is not None and not isinstance(body, bytes):
                body.seek(start)

    def _get(self, path: str, kind: type[_D]) -> _D:
        return kind.model_validate_json(self.request("GET", path).content)


def _options(options: Mapping[str, Any]) -> Document:
    """Reading options as query parameters."""
    given = {name: value for name, value in options.items() if value is not None}
    if "columns" in given:
        given["columns"] = orjson.dumps(given["columns"]).decode()
    return given


def _unreachable(error: Exception) -> ServiceFailed:
    return ServiceFailed(
        None,
        {
            "code": "server-unreachable", "detail": f"the server does not answer: {error}",
            "cause": "it is not running, or the URL is another's", "remedy": "start it, or mend the URL",
        },
    )  # fmt: skip


def _error(answer: httpx.Response) -> Refused | ServiceFailed:
    try:
        found = orjson.loads(answer.content)
        document = cast("Document", found) if isinstance(found, dict) else {}
    except orjson.JSONDecodeError:
        document = {}
    document.setdefault("detail", f"{answer.request.url} answered {answer.status_code}")
    kind = Refused if answer.status_code < 500 else ServiceFailed
    return kind(answer.status_code, document)


def _fields(document: Mapping[str, Any]) -> dict[str, Any]:
    """A problem document as the arguments of a FitterError."""
    names = ("file", "row", "column", "offset", "parameter", "cause", "remedy")
    return {
        "message": str(document.get("detail", "the service gave no reason")),
        "code": str(document.get("code", "service-failed")),
        **{name: document.get(name) for name in names},
    }
