"""sha256 of a large file's bytes, computed beside the work that follows reading them."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any, overload

#: Fewer bytes than this are hashed at once: it takes no longer than starting a thread.
AT_ONCE = 1 << 18


class Digest:
    """A sha256 to come: :meth:`begin` lets a thread compute it, who asks before has it computed.

    hashlib holds no lock of the interpreter meanwhile, so that with a core to spare it holds nobody up.

    Parameters
    ----------
    compute : gives the digest, 64 hexadecimal digits, however often it is called; OSError where bytes that it
        reads can't be read. What it holds is kept until it has been called.
    """

    def __init__(self, compute: Callable[[], str]) -> None:
        self._compute: Callable[[], str] | None = compute
        self._hex: str | None = None
        self._begun = False

    def begin(self) -> None:
        """Compute it in a thread of its own, if no call before began that."""
        if not self._begun:
            self._begun = True
            threading.Thread(target=self._beside, name="sha256").start()

    def _beside(self) -> None:
        with suppress(OSError):  # whoever asks computes it again and meets the error, too
            self.hexdigest()

    def hexdigest(self) -> str:
        """The digest, 64 hexadecimal digits."""
        compute = self._compute
        # Never waits for the thread: a forked process has none, and one that ran late would hold us up.
        if compute is not None:
            self._hex = compute()
            self._compute = None  # in this order: whoever finds nothing to compute finds the digest
        assert self._hex is not None
        return self._hex


def digest_of(content: memoryview) -> str | Digest:
    """The sha256 of ``content``: of a few bytes at once, of many as a :class:`Digest` to begin.

    The bytes are kept until it is done, whatever happens to the file; they must not be changed.
    """
    if len(content) < AT_ONCE:
        return hashlib.sha256(content).hexdigest()
    return Digest(lambda: hashlib.sha256(content).hexdigest())


class DigestField:
    """A dataclass field that may be given a :class:`Digest` and is always read as its digits."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type) -> str: ...
    @overload
    def __get__(self, instance: object, owner: type) -> str: ...
    def __get__(self, instance: object | None, owner: type) -> str:
        if instance is None:
            return ""  # the field's default
        held = instance.__dict__[self._name]
        if isinstance(held, Digest):
            held = instance.__dict__[self._name] = held.hexdigest()
        return held

    def __set__(self, instance: Any, value: str | Digest) -> None:
        instance.__dict__[self._name] = value


if TYPE_CHECKING:
    Sha256 = DigestField
else:
    #: What such a field is given; read, it is a str (which is what a static checker sees).
    Sha256 = str | Digest
