"""Screen: documents and summaries on standard output, progress and messages on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Literal, TextIO

from fitter.cli.interrupt import Interrupt

When = Literal["auto", "always", "never"]
WHEN: tuple[When, ...] = ("auto", "always", "never")


class Screen:
    """Where a verb's words go.

    json : standard output holds one JSON document and nothing else.
    progress : "auto" draws bars where standard error is a terminal.
    interrupt : what every report of progress asks whether to stop.
    """

    def __init__(
        self, interrupt: Interrupt | None = None, *, json: bool = False, progress: When = "auto"
    ) -> None:
        self._interrupt = interrupt or Interrupt()
        self.json = json
        # Taken once: while a verb works, sys.stdout is turned aside so that nobody else writes there.
        self.stdout: TextIO = sys.stdout
        self.stderr: TextIO = sys.stderr
        self._bars = progress == "always" or (progress == "auto" and self.stderr.isatty())

    def note(self, text: str) -> None:
        """One message on standard error."""
        print(f"brdf-fitter: {text}", file=self.stderr)

    def document(self, document: Mapping[str, Any]) -> None:
        """Print a JSON document on standard output."""
        from fitter.documents import dumps

        self.stdout.write(dumps(document).decode() + "\n")
        self.stdout.flush()

    def line(self, text: str = "") -> None:
        """One line on standard output."""
        print(text, file=self.stdout)

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> None:
        """A table on standard output; it is never cut or wrapped where nobody looks at a terminal."""
        from rich import box
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        drawn = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", show_edge=False)
        terminal = self.stdout.isatty()
        for column in columns:
            drawn.add_column(column, overflow="fold", no_wrap=not terminal)
        for row in rows:
            # Text, not str: a label such as "kd[R]" is no markup.
            drawn.add_row(*(Text(cell) for cell in row))
        Console(file=self.stdout, width=None if terminal else 10_000, highlight=False).print(drawn)

    def fields(self, fields: Mapping[str, str]) -> None:
        """Names and what they are, one a line, aligned."""
        width = max((len(name) for name in fields), default=0)
        for name, value in fields.items():
            self.line(f"{name:<{width}}  {value}")

    @contextmanager
    def progress(self, what: str) -> Generator[Callable[[float, str], None]]:
        """A progress callback that draws a bar on standard error, where one is wanted."""
        if not self._bars:
            yield lambda _done, _now: self._interrupt.check()
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        bars = Progress(
            TextColumn("{task.description}", markup=False), BarColumn(),
            TextColumn("{task.percentage:>3.0f}%"), TimeElapsedColumn(),
            TextColumn("{task.fields[now]}", markup=False),
            console=Console(file=self.stderr, force_terminal=True),
        )  # fmt: skip
        with bars:
            task = bars.add_task(what, total=1.0, now="")

            def report(done: float, now: str) -> None:
                self._interrupt.check()
                bars.update(task, completed=done, now=now)

            yield report
            self._interrupt.check()
            bars.update(task, completed=1.0, now="")


def number(value: object, digits: int = 5) -> str:
    """A number for people; "-" where there is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "-" if value is None else str(value)
    return f"{value:,}" if isinstance(value, int) else f"{value:.{digits}g}"


def file_size(count: int) -> str:
    """Bytes for people."""
    size, unit = float(count), "B"
    for larger in ("kB", "MB", "GB"):
        if size < 1000:
            break
        size, unit = size / 1000, larger
    return f"{size:.3g} {unit}"
