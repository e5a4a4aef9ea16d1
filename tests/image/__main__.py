"""``python -m tests.image``: the Dockerfile's steps by chroot in plain root file systems, and its service.

For machines without a container engine. It needs root, debootstrap and a network. In place of the image
python:3.11-slim stands Debian 12 with its own Python 3.11. What differs from an engine: no layers, no limits,
the network and the clock of this machine while it is built; the service runs in a network of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.image.dockerfile import Stage, copied, stages, words
from tests.image.root import Root

PROJECT = Path(__file__).resolve().parents[2]
BASE = "python:3.11-slim"
#: Of Debian 12: what the base image brings, too.
_PACKAGES = ("python3", "python3-venv", "python-is-python3", "ca-certificates")
#: Seconds that the service may take to be healthy: the health check's start period and its retries.
_PATIENCE = 120.0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.image", description=__doc__)
    parser.add_argument("--work", type=Path, required=True, metavar="DIR", help="an empty or a former folder")
    parser.add_argument(
        "--lend", type=Path, action="append", default=[], metavar="PATH",
        help="of this machine, for pip: its configuration, its mirror (repeatable)",
    )  # fmt: skip
    given = parser.parse_args()
    if os.geteuid() != 0 or shutil.which("debootstrap") is None:
        print("needs root, and debootstrap (apt-get install debootstrap)", file=sys.stderr)
        return 2
    base: Path = given.work / "base"
    if not (base / "usr/bin/python3.11").exists():
        subprocess.run(
            ["debootstrap", "--variant=minbase", f"--include={','.join(_PACKAGES)}", "bookworm", str(base)],
            check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
    lent = [Path("/etc/resolv.conf"), Path("/etc/ssl/certs"), *given.lend]
    built: dict[str, Root] = {}
    root: Root | None = None
    for stage in (described := stages(PROJECT / "Dockerfile")):
        if stage.base != BASE:
            raise SystemExit(f"no root file system stands for {stage.base}")
        place = given.work / f"stage-{stage.name}"
        shutil.rmtree(place, ignore_errors=True)
        subprocess.run(["cp", "-a", "--reflink=auto", str(base), str(place)], check=True)
        root = built[stage.name] = Root(place, tuple(path for path in lent if path.exists()))
        _build(stage, root, built)
    assert root is not None
    _serve(described[-1], root)
    print("the image's steps and its service work")
    return 0


def _build(stage: Stage, root: Root, built: Mapping[str, Root]) -> None:
    allowed = {line[1:] for line in (PROJECT / ".dockerignore").read_text().splitlines() if line[:1] == "!"}
    for step in stage.steps:
        begun = time.monotonic()
        if step.instruction == "RUN":
            root.run(["sh", "-c", step.text])
        elif step.instruction == "COPY":
            asked = copied(step.text)
            if asked.source is None and (hidden := set(asked.sources) - allowed):
                raise SystemExit(f".dockerignore hides {', '.join(sorted(hidden))}")
            root.take(built[asked.source].path if asked.source else PROJECT, asked)
        elif step.instruction == "ENV":
            root.set(step.text)
        elif step.instruction == "USER":
            root.user = step.text
        elif step.instruction == "WORKDIR":
            root.enter(step.text)
        print(
            f"{stage.name}: {step.instruction} {step.text[:60]}  ({time.monotonic() - begun:.0f} s)",
            flush=True,
        )


def _serve(stage: Stage, root: Root) -> None:
    """CMD as the user, a key beforehand; the health check and a fit; the end as `docker stop` brings it."""
    command, health = stage.last("CMD"), stage.last("HEALTHCHECK")
    assert command is not None
    assert health is not None
    made = ["brdf-fitter", "keys", "create", "--owner", "check", "--folder", "/data", "--json"]
    secret = str(json.loads(root.run(made, lend=False).stdout)["secret"])
    with root.started(words(command)) as (ending, service):
        _healthy(root, ending, service, words(health))
        ids = Path(f"/proc/{service}/status").read_text().split("Uid:")[1].split()[:4]
        assert set(ids) == {root.user}, f"the service runs as {ids}"
        for line in (
            ["brdf-fitter", "datasets", "copy", "glossy_paint", "--out", "/tmp/tables"],
            ["brdf-fitter", "--server", "http://127.0.0.1:8000", "fit", "/tmp/tables/glossy_paint.csv",
             "--model", "oren_nayar"],
        ):  # fmt: skip
            root.run(line, within=service, more={"BRDF_FITTER_KEY": secret}, lend=False)
        print("healthy, not root, and fits a table")
        os.kill(service, signal.SIGTERM)
        status = ending.wait(10)  # as long as an engine waits
        assert status == 0, f"stopped with status {status}"


def _healthy(root: Root, ending: subprocess.Popen[str], service: int, check: Sequence[str]) -> None:
    end = time.monotonic() + _PATIENCE
    while root.run(check, within=service, strict=False, lend=False).returncode != 0:
        if ending.poll() is not None or time.monotonic() > end:
            raise SystemExit(f"not healthy: {' '.join(check)}")
        time.sleep(1)


if __name__ == "__main__":
    sys.exit(main())
