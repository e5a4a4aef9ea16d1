"""The documentation is true: every command and program shown in it runs, and every link leads somewhere.

A page's ```bash and ```console blocks are run one after the other (of a console block the lines after "$ "),
its ```python blocks are one program that runs after them in the same folder, where the bundled tables lie as
NAME.csv. Other blocks are not run. ``brdf-fitter serve`` is only parsed, because a server already listens,
and ``make TARGET`` is a dry run.

Blocks are bash's, those that follow each other one script of it, and each command in them a process. Where
there is nothing but commands, whose output goes to a file at most, they run in this process instead, as
programs do: that spares starting the numerics anew some forty times.
"""

from __future__ import annotations

import os
import re
import runpy
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import pytest

from fitter import datasets
from fitter.cli.app import main, parser
from fitter.formats import formats

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
SHOWN_ADDRESS = "http://127.0.0.1:8000"
#: Pages whose commands take longer than ten seconds.
LONG = {
    "CONTRIBUTING.md", "README.md", "batch.md", "command-line.md", "cost.md", "export.md", "http.md",
    "scenes.md", "uncertainty.md",
}  # fmt: skip
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^#{1,6} (.+)$", re.MULTILINE)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")

SHIMS = {
    "brdf-fitter": """
if [ "$1" = serve ]; then
    check='import sys; from fitter.cli.app import parser; parser("serve").parse_args(sys.argv[1:])'
    exec "{python}" -c "$check" "$@"
fi
exec "{python}" -m fitter "$@"
""",
    "make": 'exec "{make}" --no-print-directory -C "{root}" --dry-run "$@" > make.txt\n',
    "python": 'exec "{python}" "$@"\n',
    "python3": 'exec "{python}" "$@"\n',
}


@dataclass(frozen=True)
class Page:
    """What of a page can be run: scripts, and a program."""

    shell: list[str]
    python: str

    @staticmethod
    def read(path: Path) -> Page:
        shell: list[str] = []
        python: list[str] = []
        for language, block in FENCE.findall(path.read_text()):
            if language == "python":
                python.append(block)
            elif language in ("bash", "sh"):
                shell.append(block)
            elif language == "console":
                shell.append(_typed(block))
        scripts = groupby(shell, key=lambda block: Command.read(block) is None)
        return Page(["\n".join(blocks) for _, blocks in scripts], "\n".join(python))


@dataclass(frozen=True)
class Command:
    """One ``brdf-fitter`` line: its words, and the file that its output goes to."""

    words: list[str]
    output: str | None

    @staticmethod
    def read(script: str) -> list[Command] | None:
        """The commands of a script that holds nothing else, or None."""
        found: list[Command] = []
        for line in script.replace("\\\n", " ").splitlines():
            try:
                words = shlex.split(line, comments=True)
            except ValueError:  # a quotation goes over lines
                return None
            output = words[-1] if words[-2:-1] == [">"] else None
            words = words[:-2] if output else words
            if words and (words[0] != "brdf-fitter" or set("".join(words)) & set("|&;<>()$`")):
                return None
            if words:
                found.append(Command(words[1:], output))
        return found

    def run(self, capsys: pytest.CaptureFixture[str]) -> None:
        if self.words[0] == "serve":
            parser("serve").parse_args(self.words)
            return
        status = main(self.words)
        out, err = capsys.readouterr()
        assert status == 0, f"{self.words}:\n{out[-4000:]}\n{err[-4000:]}"
        if self.output is not None:
            Path(self.output).write_text(out)


def _typed(block: str) -> str:
    """What a person types of a console session: lines after "$ ", with those they continue on."""
    typed: list[str] = []
    going_on = False
    for line in block.splitlines():
        if line.startswith("$ ") or going_on:
            typed.append(line.removeprefix("$ "))
            going_on = line.endswith("\\")
    return "\n".join(typed) + "\n"


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The shims first on the path; compiled programs are shared with the rest of the suite."""
    folder = tmp_path_factory.mktemp("bin")
    values = {"python": sys.executable, "make": shutil.which("make") or "make", "root": str(ROOT)}
    for name, text in SHIMS.items():
        shim = folder / name
        shim.write_text("#!/bin/sh\n" + re.sub(r"\{(\w+)\}", lambda found: values[found[1]], text))
        shim.chmod(0o755)
    Path(os.environ["JAX_COMPILATION_CACHE_DIR"]).mkdir(parents=True, exist_ok=True)
    return {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, environment: dict[str, str]) -> Iterator[str]:
    """A running server."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    folder = tmp_path_factory.mktemp("service")
    (folder / "data").mkdir()
    (folder / "data" / "xla").symlink_to(environment["JAX_COMPILATION_CACHE_DIR"])
    with (folder / "log").open("w") as log:
        running = subprocess.Popen(
            [sys.executable, "-m", "fitter", "serve", "--port", str(port), "--folder", str(folder / "data")],
            stdout=log, stderr=log, env=environment,
        )  # fmt: skip
        try:
            for _ in range(600):
                assert running.poll() is None, (folder / "log").read_text()
                try:
                    urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz", timeout=1).close()
                    break
                except (urllib.error.URLError, TimeoutError):
                    time.sleep(0.05)
            yield f"http://127.0.0.1:{port}"
        finally:
            running.send_signal(signal.SIGINT)
            running.wait(timeout=60)


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[pytest.mark.long] * (path.name in LONG)) for path in PAGES],
    ids=[path.name for path in PAGES],
)
def test_everything_shown_runs(
    path: Path, tmp_path: Path, environment: dict[str, str], request: pytest.FixtureRequest,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    page = Page.read(path)
    text = "\n".join([*page.shell, page.python])
    if not text.strip():
        return
    if SHOWN_ADDRESS in text:
        if shutil.which("curl") is None:
            pytest.skip(f"NO CURL: {path.name} is not checked")
        found = request.getfixturevalue("address")
        page = Page(
            [script.replace(SHOWN_ADDRESS, found) for script in page.shell],
            page.python.replace(SHOWN_ADDRESS, found),
        )
    for name in datasets.samples():
        shutil.copy(datasets.sample(name), tmp_path / f"{name}.csv")
    monkeypatch.chdir(tmp_path)
    for shown in page.shell:
        commands = Command.read(shown)
        for command in commands or []:
            command.run(capsys)
        if commands is None:
            script = tmp_path / "shown.bash"
            script.write_text(shown)
            done = subprocess.run(
                ["bash", "-euo", "pipefail", str(script)], env=environment, capture_output=True, text=True,
                timeout=600,
            )  # fmt: skip
            assert done.returncode == 0, f"{path.name}:\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"
    if page.python.strip():
        program = tmp_path / "shown.py"
        program.write_text(page.python)
        runpy.run_path(str(program), run_name="__main__")


def anchors(path: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and the built site make them."""
    found: set[str] = set()
    for heading in HEADING.findall(FENCE.sub("", path.read_text())):
        text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).strip().lower()
        slug = re.sub(r"[^\w\- ]", "", text).replace(" ", "-")
        found.add(next(name for k in range(99) if (name := f"{slug}-{k}" if k else slug) not in found))
    return found


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_links_lead_somewhere(path: Path) -> None:
    for target in LINK.findall(FENCE.sub("", path.read_text())):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        page = path.parent / name if name else path
        assert page.exists(), f"{path.name} links {target}"
        assert not anchor or anchor in anchors(page), f"{path.name} links {target}"


def test_every_page_is_in_the_index() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    for page in (ROOT / "docs").iterdir():
        if page.suffix in (".md", ".rst"):
            assert page.name == "index.md" or f"({page.name})" in index, page.name


def test_instructions_are_short_and_name_what_exists() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text()
    sections = re.findall(r"^## (Adding [^\n]+)\n(.*?)(?=^## )", text, re.MULTILINE | re.DOTALL)
    assert [name for name, _ in sections] == [
        "Adding a model", "Adding a format", "Adding an effect", "Adding an export", "Adding a verb",
    ]  # fmt: skip
    for name, section in sections:
        assert section.count("\n") < 50, name
    for path in re.findall(r"`((?:fitter|tests|docs|api)/[\w/.-]+)`", text):
        assert (ROOT / path).exists() or "NAME" in path, path


def test_every_format_is_documented() -> None:
    page = (ROOT / "docs" / "formats.md").read_text()
    assert set(re.findall(r"^\| `([\w-]+)` \| [^|]+ \| [^|]+ \| [^|]+ \|$", page, re.MULTILINE)) == {
        one.name for one in formats()
    }


def test_every_verb_is_documented() -> None:
    from fitter.cli.app import VERBS

    text = (ROOT / "docs" / "command-line.md").read_text()
    assert re.findall(r"^## `brdf-fitter (\w+)", text, re.MULTILINE) == list(VERBS)


def test_the_image_copies_what_exists() -> None:
    allowed = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied: set[str] = set()
    for line in (ROOT / "Dockerfile").read_text().splitlines():
        if line.startswith("COPY ") and "--from" not in line:
            copied |= set(line.split()[1:-1])
    assert copied == allowed
    assert all((ROOT / name).exists() for name in copied)
