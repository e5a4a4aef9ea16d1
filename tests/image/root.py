"""A root file system in which commands run: chroot in name spaces that end with the command."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.image.dockerfile import Copy

#: What a container has, too.
_MOUNTS = "mount -t proc proc {root}/proc; mkdir -p {root}/dev/shm; mount -t tmpfs shm {root}/dev/shm"


@dataclass
class Root:
    """A folder that is a command's /, and what the instructions so far have settled.

    lent : paths of this machine that commands of the build see, read only.
    """

    path: Path
    lent: tuple[Path, ...] = ()
    user: str = "0"
    folder: str = "/"
    environment: dict[str, str] = field(
        default_factory=lambda: {
            "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "LANG": "C.UTF-8",
        }
    )  # fmt: skip

    def set(self, text: str) -> None:
        """ENV: NAME=VALUE words, in which $PATH is what it was."""
        for word in shlex.split(text):
            name, _, value = word.partition("=")
            self.environment[name] = value.replace("$PATH", self.environment["PATH"])

    def enter(self, folder: str) -> None:
        """WORKDIR, which makes the folder."""
        self.folder = folder
        self._inside(folder).mkdir(parents=True, exist_ok=True)

    def take(self, source: Path, asked: Copy) -> None:
        """COPY from the root or the project at ``source``: of folders their content."""
        for one in asked.sources:
            path = source / one.lstrip("/")
            target = self._inside(asked.target)
            if path.is_dir():
                shutil.copytree(
                    path,
                    target,
                    symlinks=True,
                    dirs_exist_ok=True,
                    ignore=shutil.ignore_patterns("__pycache__"),
                )  # fmt: skip
            else:
                shutil.copy2(path, target / path.name if asked.target.endswith("/") else target)

    def run(
        self, words: Sequence[str], *, within: int | None = None, more: Mapping[str, str] | None = None,
        strict: bool = True, lend: bool = True,
    ) -> subprocess.CompletedProcess[str]:  # fmt: skip
        """Run a command to its end, ``within`` the name spaces of a process. Raises SystemExit."""
        enter = self._entering(lend) if within is None else self._joining(within)
        done = subprocess.run([*enter, *self._command(words, more or {})], capture_output=True, text=True)
        if strict and done.returncode:
            raise SystemExit(f"{shlex.join(words)}\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
        return done

    @contextmanager
    def started(self, words: Sequence[str]) -> Generator[tuple[subprocess.Popen[str], int]]:
        """A command that goes on, with a network of its own and as its first process, which signals end only
        if it listens to them: the process that ends when it does, and the command's id here."""
        unshare = subprocess.Popen(
            [*self._entering(False, own=True), *self._command(words, {})], text=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            children = Path(f"/proc/{unshare.pid}/task/{unshare.pid}/children")
            while not (found := children.read_text().split()) and unshare.poll() is None:
                time.sleep(0.05)
            yield unshare, int(found[0])
        finally:
            unshare.kill()  # and with it what it started
            unshare.wait()

    def _entering(self, lend: bool, *, own: bool = False) -> list[str]:
        root = shlex.quote(str(self.path))
        steps = [_MOUNTS.format(root=root)]
        for path in self.lent if lend else ():
            inside = shlex.quote(str(self._inside(str(path))))
            # The mount's place goes with the mount where nothing was there before.
            make = f"mkdir -p {inside}" if path.is_dir() else f"touch {inside}"
            steps.append(f"{make}; mount --bind -o ro {shlex.quote(str(path))} {inside}")
        if own:
            steps.append("ip link set lo up")
        spaces = ["--mount", *(["--net", "--pid", "--fork", "--kill-child"] if own else [])]
        return ["unshare", *spaces, "sh", "-ec", "; ".join([*steps, 'exec "$@"']), "sh"]

    def _joining(self, process: int) -> list[str]:
        return ["nsenter", "--target", str(process), "--mount", "--net", "--pid"]

    def _command(self, words: Sequence[str], more: Mapping[str, str]) -> list[str]:
        group, home = self._account()
        told = {**self.environment, "HOME": home, **more}
        # The command is looked up in the image's PATH, from its working directory.
        script = f'cd {shlex.quote(self.folder)} && exec "$@"'
        return [
            "chroot", f"--userspec={self.user}:{group}", str(self.path), "/usr/bin/env", "-i",
            *(f"{name}={value}" for name, value in told.items()), "sh", "-c", script, "sh", *words,
        ]  # fmt: skip

    def _account(self) -> tuple[str, str]:
        """Group and home of the user, as the image's passwd has them."""
        for line in (self.path / "etc/passwd").read_text().splitlines():
            _, _, user, group, _, home, _ = line.split(":")
            if user == self.user:
                return group, home
        raise SystemExit(f"the image has no user {self.user}")

    def _inside(self, path: str) -> Path:
        whole = path if path.startswith("/") else f"{self.folder}/{path}"
        return self.path / whole.strip("/")
