"""What a hostile file might make of its reader. A module of its own: reader processes load it."""

from __future__ import annotations

import ctypes
import time
from multiprocessing.connection import Connection
from typing import Any


def crashes(sender: Connection, *_: Any) -> None:
    ctypes.string_at(0)


def hangs(sender: Connection, *_: Any) -> None:
    time.sleep(600)


def fails(sender: Connection, *_: Any) -> None:
    sender.send_bytes(b'{"bug": "Traceback: secret"}')
