"""Values of options: texts that hold a name and numbers, and folders and files to write to."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from fitter.errors import SpecError


def pair(text: str) -> tuple[str, str]:
    """``NAME=VALUE``."""
    name, equals, value = text.partition("=")
    if not equals or not name or not value:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return name, value


def named_number(text: str) -> tuple[str, float]:
    """``NAME=NUMBER``."""
    name, value = pair(text)
    return name, _number(value, text)


def named_range(text: str) -> tuple[str, tuple[float, float]]:
    """``NAME=LOW,HIGH``."""
    name, value = pair(text)
    low, comma, high = value.partition(",")
    if not comma:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=LOW,HIGH")
    return name, (_number(low, text), _number(high, text))


def _number(value: str, text: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: {value!r} is not a number") from None


def names(text: str) -> tuple[str, ...]:
    """``NAME,NAME,...``."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def grid(text: str) -> tuple[int, int]:
    """Columns and rows, as ``8x6``."""
    columns, _, rows = text.partition("x")
    if not (columns.isdigit() and rows.isdigit() and int(columns) and int(rows)):
        raise argparse.ArgumentTypeError(f"{text!r} is not COLUMNSxROWS, as 8x6")
    return int(columns), int(rows)


def duration(text: str) -> float:
    """Seconds of ``2s``, ``500ms``, ``1.5min``, or of a bare number."""
    for unit, seconds in (("ms", 1e-3), ("min", 60.0), ("s", 1.0), ("", 1.0)):
        if text.endswith(unit):
            return seconds * _number(text.removesuffix(unit).strip(), text)
    raise AssertionError("every text ends with nothing")


def share(text: str) -> float:
    """The number that ``1%`` or ``0.01`` is."""
    if text.endswith("%"):
        return 0.01 * _number(text.removesuffix("%").strip(), text)
    return _number(text, text)


def output_folder(text: str, parameter: str = "out") -> Path:
    """A folder that can be written to; made now, because work that can't be kept should not begin."""
    folder = Path(text)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(folder, error.strerror or str(error), parameter) from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise _unwritable(folder, "permission denied", parameter)
    return folder


def output_file(text: str) -> Path:
    """A file that can be written; its folder is made now, the file when there is something to write."""
    path = Path(text)
    if path.is_dir():
        raise _unwritable(path, "it is a folder, and a file is needed")
    output_folder(str(path.parent))
    return path


def _unwritable(path: Path, reason: str, parameter: str = "out") -> SpecError:
    return SpecError(
        f"can't be written: {reason}", code="out-not-writable", file=str(path),
        parameter=parameter, remedy=f"choose another --{parameter}",
    )  # fmt: skip
