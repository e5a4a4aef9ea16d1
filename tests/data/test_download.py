"""Downloads from a server of the test's own: whole, cut and resumed, changed, refused, wrong, no room."""

from __future__ import annotations

import hashlib
import json
import struct
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

import fitter
from fitter import datasets
from fitter.databases import databases, get
from fitter.download import TRIES, download
from fitter.progress import Cancelled
from tests.cli.conftest import Run
from tests.cli.conftest import run as run

DATA = np.random.default_rng(5).bytes(300_000)
SHA = hashlib.sha256(DATA).hexdigest()


@dataclass
class Place:
    """How the server behaves, and what it was asked for.

    cuts : bytes after which each answer in turn is cut off; then it sends whole. answers : statuses that it
    gives in turn before it serves.
    """

    data: bytes = DATA
    etag: str | None = '"one"'
    modified: str | None = None
    ranges: bool = True
    kind: str = "application/octet-stream"
    stated: bool = True
    cuts: list[int] = field(default_factory=list)
    answers: list[tuple[int, dict[str, str]]] = field(default_factory=list)
    ask: list[dict[str, str]] = field(default_factory=list)
    paths: list[str] = field(default_factory=list)
    address: str = ""


@pytest.fixture
def place() -> Iterator[Place]:
    state = Place()

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *words: object) -> None: ...

        def do_GET(self) -> None:
            state.ask.append(dict(self.headers.items()))
            state.paths.append(self.path)
            if state.answers:
                status, headers = state.answers.pop(0)
                self.send_response(status)
                for key, value in {"Content-Length": "0", **headers}.items():
                    self.send_header(key, value)
                self.end_headers()
                return
            start = 0
            asked, condition = self.headers.get("Range"), self.headers.get("If-Range")
            if asked and state.ranges and condition in (state.etag, state.modified):
                start = int(asked.removeprefix("bytes=").rstrip("-"))
                if start >= len(state.data):
                    self.send_response(416)
                    self.send_header("Content-Length", "0")
                    self.end_headers()
                    return
                self.send_response(206)
                self.send_header("Content-Range", f"bytes {start}-{len(state.data) - 1}/{len(state.data)}")
            else:
                self.send_response(200)
            self.send_header("Content-Type", state.kind)
            if state.stated:
                self.send_header("Content-Length", str(len(state.data) - start))
            if state.etag:
                self.send_header("ETag", state.etag)
            if state.modified:
                self.send_header("Last-Modified", state.modified)
            self.end_headers()
            body = state.data[start:]
            self.wfile.write(body[: state.cuts.pop(0)] if state.cuts else body)

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    state.address = f"http://127.0.0.1:{server.server_address[1]}"
    yield state
    server.shutdown()
    thread.join()
    server.server_close()


class Waits(list[float]):
    """Stands in for waiting, and remembers how long."""

    def __call__(self, seconds: float) -> None:
        self.append(seconds)


def left(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_whole(place: Place, tmp_path: Path) -> None:
    shares: list[float] = []
    path = tmp_path / "new" / "a.bin"
    found = download(
        f"{place.address}/a", path, sha256=SHA, size=len(DATA), progress=lambda done, now: shares.append(done)
    )
    assert found == (len(DATA), SHA)
    assert path.read_bytes() == DATA
    assert left(path.parent) == {"a.bin"}
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert "Range" not in place.ask[0]


@pytest.mark.parametrize("validator", ["etag", "modified"])
def test_a_cut_is_resumed_where_it_was(place: Place, tmp_path: Path, validator: str) -> None:
    place.cuts = [100_000, 50_000]
    if validator == "modified":
        place.etag, place.modified = 'W/"weak"', "Mon, 01 Jan 2024 00:00:00 GMT"
    waits = Waits()
    assert download(f"{place.address}/a", tmp_path / "a", sha256=SHA, pause=waits) == (len(DATA), SHA)
    assert [ask.get("Range") for ask in place.ask] == [None, "bytes=100000-", "bytes=150000-"]
    expected = place.etag if validator == "etag" else place.modified
    assert {ask.get("If-Range") for ask in place.ask[1:]} == {expected}
    assert waits == [1.0, 1.0]  # each brought something new


def test_the_next_call_goes_on(place: Place, tmp_path: Path) -> None:
    def stop(done: float, now: str) -> None:
        if done > 0.3:
            raise Cancelled

    with pytest.raises(Cancelled):
        download(f"{place.address}/a", tmp_path / "a", progress=stop)
    assert left(tmp_path) == {".a.part", ".a.part.json"}
    kept = (tmp_path / ".a.part").stat().st_size
    assert 0 < kept < len(DATA)
    assert download(f"{place.address}/a", tmp_path / "a") == (len(DATA), SHA)
    assert place.ask[1]["Range"] == f"bytes={kept}-"
    assert left(tmp_path) == {"a"}


@pytest.mark.parametrize("how", ["changed", "no ranges", "no validator", "another address"])
def test_what_can_not_be_resumed_begins_anew(place: Place, tmp_path: Path, how: str) -> None:
    """Never two versions in one file: the condition fails, or nothing is asked for."""
    old = bytes(100_000)
    (tmp_path / ".a.part").write_bytes(old)
    notes = {"url": f"{place.address}/a", "validator": '"one"'}
    if how == "changed":
        place.etag = '"two"'
    elif how == "no ranges":
        place.ranges = False
    elif how == "no validator":
        notes["validator"] = None
    else:
        notes["url"] = f"{place.address}/b"
    (tmp_path / ".a.part.json").write_text(json.dumps(notes))
    assert download(f"{place.address}/a", tmp_path / "a") == (len(DATA), SHA)
    assert ("Range" in place.ask[0]) == (how in ("changed", "no ranges"))


def test_changed_between_two_cuts(place: Place, tmp_path: Path) -> None:
    place.cuts = [100_000]
    waits = Waits()

    def changed(seconds: float) -> None:
        waits(seconds)
        place.etag, place.data = '"two"', DATA[::-1]

    assert download(f"{place.address}/a", tmp_path / "a", pause=changed)[0] == len(DATA)
    assert (tmp_path / "a").read_bytes() == DATA[::-1]
    assert waits == [1.0]


def test_a_server_that_joins_two_versions_is_found_out(place: Place, tmp_path: Path) -> None:
    """The same validator for other bytes: the hash tells, and it is fetched whole once more."""
    (tmp_path / ".a.part").write_bytes(bytes(100_000))
    (tmp_path / ".a.part.json").write_text(
        json.dumps({"url": f"{place.address}/a", "validator": place.etag})
    )
    assert download(f"{place.address}/a", tmp_path / "a", sha256=SHA) == (len(DATA), SHA)
    assert [("Range" in ask) for ask in place.ask] == [True, False]


def test_more_than_the_server_has(place: Place, tmp_path: Path) -> None:
    (tmp_path / ".a.part").write_bytes(bytes(len(DATA)))
    (tmp_path / ".a.part.json").write_text(
        json.dumps({"url": f"{place.address}/a", "validator": place.etag})
    )
    assert download(f"{place.address}/a", tmp_path / "a", pause=Waits()) == (len(DATA), SHA)


def test_a_body_of_unstated_length(place: Place, tmp_path: Path) -> None:
    place.stated = False
    assert download(f"{place.address}/a", tmp_path / "a", size=len(DATA)) == (len(DATA), SHA)


def test_busy_servers_are_asked_again(place: Place, tmp_path: Path) -> None:
    place.answers = [(503, {"Retry-After": "7"}), (500, {}), (429, {"Retry-After": "9999"})]
    waits = Waits()
    assert download(f"{place.address}/a", tmp_path / "a", pause=waits) == (len(DATA), SHA)
    assert waits == [7.0, 2.0, 30.0]


def test_redirects(place: Place, tmp_path: Path) -> None:
    place.answers = [(302, {"Location": "/elsewhere"})]
    assert download(f"{place.address}/a", tmp_path / "a") == (len(DATA), SHA)
    assert place.paths == ["/a", "/elsewhere"]
    place.answers = [(302, {"Location": "file:///etc/passwd"})]
    with pytest.raises(fitter.FitError) as caught:
        download(f"{place.address}/a", tmp_path / "b", pause=Waits())
    assert caught.value.code == "download-refused"


@pytest.mark.parametrize("status", [401, 403, 404, 410])
def test_refused_at_once(place: Place, tmp_path: Path, status: int) -> None:
    place.answers = [(status, {})]
    with pytest.raises(fitter.FitError, match=str(status)) as caught:
        download(f"{place.address}/a?key=secret", tmp_path / "a", pause=Waits())
    assert (caught.value.code, len(place.ask)) == ("download-refused", 1)
    assert caught.value.cause
    assert caught.value.remedy
    assert "secret" not in str(caught.value)
    assert left(tmp_path) == set()


def test_a_web_page_is_no_file(place: Place, tmp_path: Path) -> None:
    place.kind, place.data = "text/html; charset=utf-8", b"<html>log in</html>"
    with pytest.raises(fitter.FitError, match="web page"):
        download(f"{place.address}/a", tmp_path / "a")
    assert left(tmp_path) == set()


@pytest.mark.parametrize(("fact", "says"), [({"sha256": "0" * 64}, SHA), ({"size": 7}, "300,000")])
def test_another_file_than_expected(place: Place, tmp_path: Path, fact: dict, says: str) -> None:
    with pytest.raises(fitter.FitError, match=says) as caught:
        download(f"{place.address}/a", tmp_path / "a", **fact)
    assert caught.value.code == "download-differs"
    assert left(tmp_path) == set()


def test_no_server(tmp_path: Path) -> None:
    waits = Waits()
    with pytest.raises(fitter.FitError, match=f"{TRIES} times") as caught:
        download("http://127.0.0.1:9/a", tmp_path / "a", pause=waits)
    assert caught.value.code == "download-failed"
    assert waits == [1.0, 2.0, 4.0, 8.0]


def test_always_cut_at_the_same_place(place: Place, tmp_path: Path) -> None:
    place.cuts = [1000] + [0] * 10
    with pytest.raises(fitter.FitError, match="cut at byte 1,000 of 300,000"):
        download(f"{place.address}/a", tmp_path / "a", pause=Waits())
    assert (tmp_path / ".a.part").read_bytes() == DATA[:1000]


def test_no_room(place: Place, tmp_path: Path) -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("NO /dev/full: a full disk can't be made")
    (tmp_path / ".a.part").symlink_to(full)
    with pytest.raises(fitter.FitError, match="No space left") as caught:
        download(f"{place.address}/a", tmp_path / "a")
    assert caught.value.code == "download-not-written"
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    "url",
    ["file:///etc/passwd", "ftp://host/a", "nothing", "http:///a", "http://h/a b", "http://h:x/", "http://h/ü"],
)
def test_only_the_web(url: str, tmp_path: Path) -> None:
    with pytest.raises(fitter.SpecError) as caught:
        download(url, tmp_path / "a")
    assert caught.value.code == "bad-address"


def test_the_catalogue_says_what_is_not_verified() -> None:
    known = databases()
    assert list(known) == ["merl", "rgl", "rgl-spectral", "utia", "curet", "cornell"]
    formats = {entry.name for entry in fitter.formats.formats()}
    for one in known.values():
        assert one.format in formats
        assert one.holds
        assert one.citation
        assert one.not_verified
        assert one.homepage.startswith("http")
        assert "{item}" in one.file
        assert one.url is None or ("{item}" in one.url and one.url.startswith("https://"))
        assert len(set(one.items)) == len(one.items)
        assert set(one.sha256) | set(one.sizes_bytes) <= set(one.items)
        assert all(len(bytes.fromhex(digest)) == 32 for digest in one.sha256.values())
        assert (one.licence is not None) or "licence" in one.not_verified
    assert len(known["merl"].items) == 100
    assert known["merl"].size_bytes == 12 + 3 * 90 * 90 * 180 * 8


@pytest.mark.measured
def test_known_hashes_are_those_of_the_files(shared: Path) -> None:
    rgl = databases()["rgl"]
    for item, digest in rgl.sha256.items():
        data = (shared / "measured/rgl" / rgl.file.replace("{item}", item)).read_bytes()
        assert hashlib.sha256(data).hexdigest() == digest
        assert len(data) == rgl.size(item)


def test_get_from_another_place(place: Place, tmp_path: Path) -> None:
    found = get("rgl-spectral", ["aurora_white"], tmp_path, source=f"{place.address}/{{item}}/x?a=b")
    assert place.paths == ["/aurora_white/x?a=b"]
    assert found[0].path == tmp_path / "aurora_white_spec.bsdf"
    assert (found[0].checked, found[0].downloaded, found[0].sha256) == ("", True, SHA)
    again = get("rgl-spectral", ["aurora_white"], tmp_path, source=place.address)
    assert (again[0].downloaded, len(place.paths)) == (False, 1)


def test_a_hash_that_is_known_is_required(place: Place, tmp_path: Path) -> None:
    place.data = DATA[:658_960]
    with pytest.raises(fitter.FitError) as caught:
        get("rgl", ["aurora_white"], tmp_path, source=place.address)
    assert caught.value.code == "download-differs"
    (tmp_path / "aurora_white_rgb.bsdf").write_bytes(b"mine")
    with pytest.raises(fitter.FitError, match="that is there"):
        get("rgl", ["aurora_white"], tmp_path, source=place.address)
    assert (tmp_path / "aurora_white_rgb.bsdf").read_bytes() == b"mine"


def test_the_command(place: Place, tmp_path: Path, run: Run) -> None:
    dims = (90, 90, 180)
    place.data = struct.pack("<3i", *dims) + np.full(3 * np.prod(dims), 150.0).tobytes()
    source = f"{place.address}/brdfs/"
    words = ["datasets", "get", "merl", "brass", "chrome", "--from", source, "--out", tmp_path]
    done = run(*words, "--json")
    assert done.status == 0
    assert done.document["licence"] == "CC-BY-SA-4.0"
    assert [Path(file["path"]).name for file in done.document["files"]] == ["brass.binary", "chrome.binary"]
    assert [file["checked"] for file in done.document["files"]] == ["size", "size"]
    assert place.paths == ["/brdfs/brass.binary", "/brdfs/chrome.binary"]
    assert fitter.load(tmp_path / "brass.binary").metadata.source_format == "merl"
    again = run(*words)
    assert (again.status, len(place.paths)) == (0, 2)
    assert "was there already" in again.out
    assert "cite: W. Matusik" in again.out
    place.answers = [(404, {})]
    failed = run("datasets", "get", "merl", "steel", "--from", place.address, "--out", tmp_path, "--json")
    assert (failed.status, failed.document["error"]["code"]) == (1, "download-refused")


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["get"], "bad-call"), (["get", "merl"], "bad-call"), (["get", "nobody", "x"], "unknown-database"),
        (["get", "merl", "gold"], "unknown-item"), (["get", "utia", "m001"], "no-address"),
        (["get", "cornell", "--all"], "bad-call"), (["list", "nobody"], "unknown-database"),
        (["get", "cornell", "../x", "--from", "http://127.0.0.1:9"], "unknown-item"),
        (["get", "cornell", "x", "--from", "file:///etc"], "bad-address"),
        (["list", "merl", "rgl"], "bad-call"),
    ],
)  # fmt: skip
def test_wrong_calls(words: list[str], code: str, run: Run, tmp_path: Path) -> None:
    done = run("datasets", *words, "--out", tmp_path, "--json")
    assert (done.status, done.document["error"]["code"]) == (2, code)


def test_listing(run: Run) -> None:
    document = run("datasets", "list", "--json").document
    assert [one["name"] for one in document["databases"]] == list(databases())
    assert document["databases"][0]["items"] == 100
    one = run("datasets", "list", "rgl", "--json").document
    assert one["kind"] == "brdf-fitter/database"
    assert one["items"] == list(datasets.databases()["rgl"].items)
    text = run("datasets", "list", "utia").out
    assert "licence" in text
    assert "not verified" in text
