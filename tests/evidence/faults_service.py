"""The service that the faults study breaks: its processes, its PostgreSQL, and its disk, all of its own."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Generator
from pathlib import Path

import httpx
import psutil

ROOT = Path(__file__).resolve().parents[2]
#: Bytes of the disk that holds the service's folder.
DISK = 400 << 20


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Postgres:
    """A PostgreSQL cluster in a folder, made by initdb, with a server that can be stopped and started."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._port = free_port()
        found = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
        self._bin = found[-1] if found else Path(shutil.which("initdb") or "initdb").parent
        folder.mkdir()
        if os.geteuid() == 0:
            shutil.chown(folder, "postgres")
        self._run("initdb", "-D", str(folder / "db"), "-U", "postgres", "-A", "trust")
        self.start()

    @property
    def url(self) -> str:
        return f"postgresql://postgres@127.0.0.1:{self._port}/postgres"

    def start(self) -> None:
        options = f"-p {self._port} -c listen_addresses=127.0.0.1 -k {self._folder}"
        self._control("start", "-o", options, "-l", str(self._folder / "log"))

    def stop(self) -> None:
        self._control("stop", "-m", "fast")

    def _control(self, *words: str) -> None:
        self._run("pg_ctl", "-D", str(self._folder / "db"), "-w", *words)

    def _run(self, program: str, *words: str) -> None:
        # PostgreSQL refuses to run as root.
        user = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
        command = [*user, str(self._bin / program), *words]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=self._folder)


@contextlib.contextmanager
def small_disk(folder: Path) -> Generator[bool]:
    """The folder as a small disk of its own (tmpfs), which takes the right to mount; False without it."""
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(folder)]
    mounted = shutil.which("mount") is not None and subprocess.run(words, capture_output=True).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)


@contextlib.contextmanager
def full(folder: Path) -> Generator[None]:
    """Not a byte left on the folder's disk, and whatever is given up meanwhile is taken at once."""
    ballast = folder / "ballast"
    over = threading.Event()

    def fill() -> None:
        with ballast.open("wb", buffering=0) as file:
            while not over.wait(0.002):
                for size in (1 << 16, 1 << 12):
                    with contextlib.suppress(OSError):
                        while file.write(bytes(size)) == size:
                            pass

    filling = threading.Thread(target=fill)
    filling.start()
    try:
        yield
    finally:
        over.set()
        filling.join()
        ballast.unlink()


class Service:
    """``brdf-fitter serve --engine dask``, started again by :meth:`start` on the same port and folder."""

    def __init__(self, folder: Path, log: Path, database: str | None) -> None:
        self.folder = folder
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self._database = database
        self._log = log.open("ab")
        self._process: subprocess.Popen[bytes] | None = None

    def command(self, verb: str, *words: str) -> subprocess.CompletedProcess[bytes]:
        """Another verb of the command, on the same data."""
        place = ["--folder", str(self.folder), *(["--database", self._database] if self._database else [])]
        command = [sys.executable, "-m", "fitter", verb, *words, *place]
        return subprocess.run(command, check=True, capture_output=True, cwd=ROOT)

    def start(self) -> None:
        """Start it and wait until it answers."""
        place = ["--folder", str(self.folder), *(["--database", self._database] if self._database else [])]
        command = [
            sys.executable, "-m", "fitter", "serve", "--port", str(self.port), "--engine", "dask", *place,
        ]  # fmt: skip
        self._process = subprocess.Popen(command, stdout=self._log, stderr=self._log, cwd=ROOT)
        end = time.monotonic() + 120
        while True:
            # Until it listens; that it does in time is asked below.
            with contextlib.suppress(httpx.TransportError):
                if httpx.get(f"{self.url}/healthz", timeout=5).status_code == 200:
                    return
            if self._process.poll() is not None or time.monotonic() > end:
                raise RuntimeError("the server does not start; see its log")
            time.sleep(0.05)

    def victims(self, kind: str) -> list[psutil.Process]:
        """The processes of a kind: worker, scheduler, server."""
        assert self._process is not None
        if kind == "server":
            return [psutil.Process(self._process.pid)]
        found: list[psutil.Process] = []
        for one in psutil.Process(self._process.pid).children():
            with contextlib.suppress(psutil.Error):
                words = one.cmdline()
                if "api.dask_process" in words and ("--scheduler" in words) == (kind == "worker"):
                    found.append(one)
        return found

    def kill(self, victim: psutil.Process) -> None:
        victim.send_signal(signal.SIGKILL)
        if self._process is not None and victim.pid == self._process.pid:
            self._process.wait()

    def stop(self) -> int:
        """Ask it to stop, as an operator would."""
        assert self._process is not None
        self._process.send_signal(signal.SIGTERM)
        return self._process.wait(60)

    def close(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._log.close()
