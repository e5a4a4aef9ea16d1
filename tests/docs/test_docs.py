"""The documentation is true: every command and program shown in it runs, and every link leads somewhere.

A page's ```bash and ```console blocks are one script (of a console block the lines after "$ "), its
```python blocks one program that runs after it in the same folder, where the bundled tables lie as NAME.csv.
Other blocks are not run. ``brdf-fitter serve`` is only parsed, because a server already listens, and
``make TARGET`` is a dry run.
"""

from __future__ import annotations

import os
import re
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
from pathlib import Path

import pytest

from fitter import datasets

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
SHOWN_ADDRESS = "http://127.0.0.1:8000"
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
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
    """What of a page can be run."""

    shell: str
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
        return Page("\n".join(shell), "\n".join(python))


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
                except urllib.error.URLError:
                    time.sleep(0.05)
            yield f"http://127.0.0.1:{port}"
        finally:
            running.send_signal(signal.SIGINT)
            running.wait(timeout=60)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_everything_shown_runs(
    path: Path, tmp_path: Path, environment: dict[str, str], request: pytest.FixtureRequest
) -> None:
    page = Page.read(path)
    text = page.shell + page.python
    if not text.strip():
        return
    if SHOWN_ADDRESS in text:
        if shutil.which("curl") is None:
            pytest.skip(f"NO CURL: {path.name} is not checked")
        found = request.getfixturevalue("address")
        page = Page(page.shell.replace(SHOWN_ADDRESS, found), page.python.replace(SHOWN_ADDRESS, found))
    for name in datasets.samples():
        shutil.copy(datasets.sample(name), tmp_path / f"{name}.csv")
    for words, script in ((["bash", "-euo", "pipefail"], page.shell), ([sys.executable], page.python)):
        if not script.strip():
            continue
        written = tmp_path / f"shown.{Path(words[0]).name}"
        written.write_text(script)
        done = subprocess.run(
            [*words, str(written)], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=600
        )
        assert done.returncode == 0, f"{path.name}:\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_links_lead_somewhere(path: Path) -> None:
    for target in LINK.findall(FENCE.sub("", path.read_text())):
        if "://" in target or target.startswith("#"):
            continue
        assert (path.parent / target.partition("#")[0]).exists(), f"{path.name} links {target}"


def test_every_page_is_in_the_index() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    for page in (ROOT / "docs").glob("*.md"):
        assert page.name == "index.md" or f"({page.name})" in index, page.name


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
