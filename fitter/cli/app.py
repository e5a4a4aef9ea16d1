"""The command itself: finds the verb, runs it, and turns its end into output and an exit status."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import sys
import traceback
from collections.abc import Sequence
from typing import Any, NoReturn

from fitter import __version__
from fitter.cli.interrupt import Interrupt
from fitter.cli.screen import WHEN, Screen
from fitter.cli.verb import CALL_WRONG, DONE, INTERRUPTED, PIPE_CLOSED, WORK_FAILED, Outcome, Verb
from fitter.errors import FitError, FitterError, SpecError

#: The verbs, in the order a person needs them: each is a module of fitter.cli.verbs with a ``VERB``.
VERBS = (
    "info", "check", "fit", "posterior", "calibrate", "report", "tradeoff", "compress", "decompress",
    "convert", "export", "sample", "scene", "batch", "compare", "models", "datasets", "serve", "db", "keys",
    "gc", "backup", "demo",
)  # fmt: skip


class _Parser(argparse.ArgumentParser):
    """A parser whose mistakes are SpecErrors, and whose epilog is made only when the help is shown."""

    verb: Verb | None = None

    def error(self, message: str) -> NoReturn:
        raise SpecError(message, code="bad-call", remedy=f"see `{self.prog} --help`")

    def format_help(self) -> str:
        if self.verb is not None and self.verb.epilog is not None:
            self.epilog = self.verb.epilog()
        return super().format_help()


def verb(name: str) -> Verb:
    """The verb of that name."""
    found = importlib.import_module(f"fitter.cli.verbs.{name}").VERB
    assert isinstance(found, Verb)
    return found


def parser(chosen: str | None = None) -> argparse.ArgumentParser:
    """The command's parser. Only the ``chosen`` verb gets its arguments: help has to be instant."""
    found = {name: verb(name) for name in VERBS}
    width = max(len(name) for name in VERBS)
    listed = "\n".join(f"  {name:<{width}}  {one.summary}" for name, one in found.items())
    top = _Parser(
        prog="brdf-fitter",
        description=f"Fit reflectance models to measured BRDF tables.\n\nverbs:\n{listed}",
        epilog="`brdf-fitter VERB --help` explains a verb.\n"
        "Exit status: 0 done, 1 the work failed, 2 the call or the input was wrong, 130 interrupted.",
        formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False,
    )  # fmt: skip
    top.add_argument(
        "--server", metavar="URL",
        help="have a running service do the work of info, check, fit, posterior, report or sample, or get a "
        "batch's tables from it; an API key is taken from BRDF_FITTER_KEY",
    )  # fmt: skip
    top.add_argument("--version", action="version", version=f"brdf-fitter {__version__}")
    verbs: Any = top.add_subparsers(dest="verb", metavar="VERB", required=True, parser_class=_Parser)
    for name, one in found.items():
        sub: _Parser = verbs.add_parser(
            name, description=f"{one.summary[0].upper()}{one.summary[1:]}.",
            formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False,
        )  # fmt: skip
        sub.verb = one
        if name != chosen:
            continue
        one.configure(sub)
        sub.add_argument(
            "--json", action="store_true", help="print one JSON document on standard output and nothing else"
        )
        sub.add_argument(
            "--progress", choices=WHEN, default="auto",
            help="progress bars on standard error (default: where it is a terminal)",
        )  # fmt: skip
    return top


def main(arguments: Sequence[str] | None = None, interrupt: Interrupt | None = None) -> int:
    """Run the command; returns its exit status."""
    interrupt = interrupt or Interrupt()
    words = list(sys.argv[1:] if arguments is None else arguments)
    # The call itself may be what is wrong, and a program that asked for JSON still wants it then.
    screen = Screen(interrupt, json="--json" in words)
    try:
        chosen = _verb_in(words)
        options = parser(chosen).parse_args(words)
        screen = Screen(interrupt, json=options.json, progress=options.progress)
        # Whatever a library prints must not get between the document's bytes.
        with contextlib.redirect_stdout(sys.stderr):
            outcome = _run(options, screen)
        if outcome is None:
            return DONE
        interrupt.check()
        if screen.json:
            screen.document(outcome.document)
        else:
            outcome.show(screen)
        screen.stdout.flush()
        return outcome.status
    except SystemExit as end:  # --help and --version
        return end.code if isinstance(end.code, int) else DONE
    except BrokenPipeError:
        return _pipe_closed(screen)
    except KeyboardInterrupt:
        screen.note("interrupted")
        return INTERRUPTED
    except Exception as error:
        return _failed(error, screen)


def _verb_in(words: Sequence[str]) -> str | None:
    """The verb that was asked for: the first word that is neither an option nor one's value."""
    before = ["", *words[:-1]]
    return next(
        (word for last, word in zip(before, words, strict=False) if word[:1] != "-" and last != "--server"),
        None,
    )


def _run(options: argparse.Namespace, screen: Screen) -> Outcome | None:
    if options.server is None:
        return verb(options.verb).run(options, screen)
    # The service lives above the library, and so does what talks to it: imported at this edge only.
    from api.remote import run

    return run(options, screen, key=os.environ.get("BRDF_FITTER_KEY"))


def entry() -> NoReturn:
    """The command as a process: :func:`main`, then the end."""
    interrupt = Interrupt()
    interrupt.install()
    status = main(interrupt=interrupt)
    if status == INTERRUPTED:
        # The compiler's threads may still be at work: ending Python under them crashes or waits for them.
        # Nothing is half-written, since files are renamed when they are whole.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    sys.exit(status)


def _failed(error: Exception, screen: Screen) -> int:
    """Say what went wrong: for a person on standard error, for a program on standard output."""
    status = WORK_FAILED
    if isinstance(error, FitterError):
        known = error
        status = WORK_FAILED if isinstance(error, FitError) else CALL_WRONG
    elif isinstance(error, MemoryError):
        known = FitError("there is not enough memory", code="out-of-memory", remedy="fit a smaller --subset")
    elif isinstance(error, OSError):
        file = error.filename if isinstance(error.filename, str) else None
        known = FitError(f"the system said: {error.strerror or error}", code="system-error", file=file)
    else:
        traceback.print_exception(error, file=screen.stderr)
        known = FitError(
            f"{type(error).__name__}: {error}", code="internal-error",
            cause="a mistake in this program, not in your data",
            remedy="please report it with the lines above",
        )  # fmt: skip
    screen.note(f"error: {known}")
    if screen.json:
        try:
            screen.document({"error": known.to_dict()})
        except BrokenPipeError:
            return _pipe_closed(screen)
    return status


def _pipe_closed(screen: Screen) -> int:
    """Whoever read our output has gone: stop as quietly as a program that SIGPIPE ends."""
    with contextlib.suppress(OSError, ValueError):
        # The interpreter flushes standard output once more as it leaves; let that go nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), screen.stdout.fileno())
    return PIPE_CLOSED
