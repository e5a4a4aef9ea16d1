"""Outages: what passes by itself, and what an answer or a job says of it meanwhile."""

from __future__ import annotations

import errno
from typing import Any

from sqlalchemy.exc import InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeout

from api.problems import document

#: The database is restarted, its connections were cut, all of them are in use, its disk is full.
DATABASE = (OperationalError, InterfaceError, PoolTimeout)
#: Seconds after which a client may try again.
RETRY_AFTER = 5


def outage(error: Exception) -> dict[str, Any] | None:
    """The problem document of an error that is an outage; None for all others."""
    if isinstance(error, DATABASE):
        return document(503, "database-away", "the database does not answer", remedy="try again in a moment")
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return document(
            507, "disk-full", "the server's disk is full", remedy="tell the server's operator, then try again"
        )
    return None
