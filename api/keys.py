"""Keys: who may do what. A key's secret is shown once, when it is made; the database has its hash."""

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Any, Literal, get_args

from sqlalchemy import select

from api.documents import when
from api.rows import KeyRow
from api.sessions import Sessions, is_id, new_id
from fitter.errors import SpecError

Scope = Literal["read", "write", "admin"]
#: Each allows what those before it allow.
SCOPES: tuple[Scope, ...] = get_args(Scope)
PREFIX = "brdf_"


@dataclass(frozen=True)
class Caller:
    """Who asks.

    owner : whose rows these are; "" for everybody where no keys are needed.
    key : the key's id, None where none is needed.
    """

    owner: str = ""
    key: str | None = None
    scope: Scope = "admin"

    def may(self, scope: Scope) -> bool:
        return SCOPES.index(self.scope) >= SCOPES.index(scope)

    @property
    def sees_all(self) -> bool:
        """Whether other owners' rows exist for this caller."""
        return self.scope == "admin"


def create(store: Sessions, owner: str, scope: Scope, name: str = "") -> tuple[KeyRow, str]:
    """A new key and its secret, which nobody can find out again. Raises SpecError."""
    for parameter, text, least in (("owner", owner, 1), ("name", name, 0)):
        if not least <= len(text) <= 64 or not text.isprintable():
            raise SpecError(
                f"{parameter} can't be {text[:64]!r}", code="bad-key", parameter=parameter,
                remedy=f"give {least} to 64 printable characters",
            )  # fmt: skip
    if scope not in SCOPES:
        raise SpecError(
            f"scope can't be {scope!r}", code="bad-key", parameter="scope",
            remedy=f"use one of {', '.join(SCOPES)}",
        )  # fmt: skip
    secret = PREFIX + secrets.token_urlsafe(32)
    row = KeyRow(
        id=new_id(), created=time.time(), owner=owner, name=name, scope=scope, hash=_hash(secret)
    )  # fmt: skip
    store.add(row)
    return row, secret


def revoke(store: Sessions, id: str) -> KeyRow:
    """The key is good no longer, from the next request on. Raises SpecError where there is none."""
    with store.writing() as session:
        row = session.get(KeyRow, id) if is_id(id) else None
        if row is None:
            raise SpecError(
                f"there is no key {id[:64]!r}", code="unknown-key", parameter="id",
                remedy="see `brdf-fitter keys list`",
            )  # fmt: skip
        row.revoked = row.revoked or time.time()
        return row


def listed(store: Sessions) -> Sequence[KeyRow]:
    """All keys, oldest first."""
    with store.reading() as session:
        return session.scalars(select(KeyRow).order_by(KeyRow.created, KeyRow.id)).all()


def exist(store: Sessions) -> bool:
    """Whether there is a key that is good."""
    with store.reading() as session:
        return session.scalar(select(KeyRow.id).where(KeyRow.revoked.is_(None)).limit(1)) is not None


def are_needed(choice: Literal["auto", "on", "off"], host: str, url: str) -> bool:
    """Whether a server that listens on ``host`` and works on the database at ``url`` asks for keys.

    ``auto`` : where a key exists; without any, only this machine is served.

    Raises SpecError where nobody could use the server, and where everybody could and nobody said so.
    """
    if choice == "off":
        return False
    store = Sessions(url)
    try:
        known = exist(store)
    finally:
        store.close()
    if known or (choice == "auto" and _is_loopback(host)):
        return known
    raise SpecError(
        f"there is no API key, and {host} is "
        + ("to be served with keys" if choice == "on" else "an address that others can reach"),
        code="no-keys", parameter="keys",
        remedy="make one with `brdf-fitter keys create --owner NAME`, or serve everybody with --keys off",
    )  # fmt: skip


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def caller(store: Sessions, secret: str) -> Caller | None:
    """Whose secret this is, None where it is nobody's any more.

    Secrets are 256 random bits: their plain hash can't be guessed backwards, and finding it takes one look.
    """
    with store.reading() as session:
        query = select(KeyRow).where(KeyRow.hash == _hash(secret), KeyRow.revoked.is_(None))
        row = session.scalar(query)
    if row is None:
        return None
    return Caller(row.owner, row.id, SCOPES[SCOPES.index(row.scope)])  # pyright: ignore[reportArgumentType]


def document(row: KeyRow) -> dict[str, Any]:
    """A key without its secret."""
    return {
        "id": row.id, "owner": row.owner, "name": row.name, "scope": row.scope, "created": when(row.created),
        "revoked": None if row.revoked is None else when(row.revoked),
    }  # fmt: skip


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode("utf-8", "replace")).hexdigest()
