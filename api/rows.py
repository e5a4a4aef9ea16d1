"""Rows: what the database holds."""

from __future__ import annotations

from typing import Any

from sqlalchemy import JSON, BigInteger, Boolean, Float, Index, Integer, LargeBinary, String
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from api.states import QUEUED


class Base(DeclarativeBase):
    """Everything the database holds. A change here needs a step in ``api/migrations/versions``."""

    type_annotation_map = {dict[str, Any]: JSON, list[Any]: JSON}  # noqa: RUF012 (SQLAlchemy's own idiom)


class Row(Base):
    """Most rows: a random id (32 hexadecimal digits), when it was made (seconds since 1970, UTC), and whose.

    owner : of the API key that asked for it, "" where none was needed.
    """

    __abstract__ = True

    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    created: Mapped[float] = mapped_column(Float(53), index=True)
    owner: Mapped[str] = mapped_column(String(64), default="", server_default="", index=True)


class TableRow(Row):
    """An uploaded table: a blob and how to read it."""

    __tablename__ = "tables"

    name: Mapped[str] = mapped_column(String(255))
    sha256: Mapped[str] = mapped_column(String(64), index=True)
    size: Mapped[int] = mapped_column(BigInteger)
    options: Mapped[dict[str, Any]]
    description: Mapped[dict[str, Any]]


class JobRow(Row):
    """Work that takes time. The row is the record: what the queue and its clients know is here.

    server : who has claimed the job, until ``lease`` (seconds since 1970 by the database's clock).
    worker : the process that works on this attempt, None until one does, ``server`` where that does itself.
    losses : attempts that ended with the death of who worked on them. events : how many there are in its log.
    ``table_id`` is empty where the work needs no table.
    """

    __tablename__ = "jobs"
    __table_args__ = (Index("jobs_by_state", "state", "created"), Index("jobs_by_lease", "state", "lease"))

    kind: Mapped[str] = mapped_column(String(16))
    state: Mapped[str] = mapped_column(String(16), default=QUEUED)
    request: Mapped[dict[str, Any]]
    table_id: Mapped[str] = mapped_column(String(32), index=True)
    attempt: Mapped[int] = mapped_column(Integer, default=0)
    cancel: Mapped[bool] = mapped_column(Boolean, default=False)
    share: Mapped[float] = mapped_column(Float(53), default=0.0)
    what: Mapped[str] = mapped_column(String(255), default="")
    started: Mapped[float | None] = mapped_column(Float(53), default=None)
    finished: Mapped[float | None] = mapped_column(Float(53), default=None)
    results: Mapped[list[Any]] = mapped_column(JSON, default=list)
    problem: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True), default=None)
    server: Mapped[str | None] = mapped_column(String(64), default=None)
    worker: Mapped[str | None] = mapped_column(String(255), default=None)
    lease: Mapped[float | None] = mapped_column(Float(53), default=None)
    losses: Mapped[int] = mapped_column(Integer, default=0, server_default="0")
    events: Mapped[int] = mapped_column(Integer, default=0, server_default="0")


class EventRow(Base):
    """What became of a job, number ``seq`` from 1, without gaps: written with the change that it tells of.

    kind : ``progress``, or the final state. data : what of the job's row changes, as it was then.
    """

    __tablename__ = "job_events"

    job_id: Mapped[str] = mapped_column(String(32), primary_key=True)
    seq: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)
    created: Mapped[float] = mapped_column(Float(53))
    kind: Mapped[str] = mapped_column(String(16))
    data: Mapped[dict[str, Any]]


class ModelRow(Row):
    """A reflectance model: fitted (its id is the fit's) or uploaded."""

    __tablename__ = "models"

    origin: Mapped[str] = mapped_column(String(16), index=True)
    name: Mapped[str] = mapped_column(String(255))
    document: Mapped[dict[str, Any]]
    table_id: Mapped[str | None] = mapped_column(String(32), index=True, default=None)
    job_id: Mapped[str | None] = mapped_column(String(32), default=None)
    summary: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True), default=None)


class TradeoffRow(Row):
    """What accuracy costs, measured on a table."""

    __tablename__ = "tradeoffs"

    table_id: Mapped[str] = mapped_column(String(32))
    job_id: Mapped[str] = mapped_column(String(32))
    summary: Mapped[dict[str, Any]]


class SceneRow(Row):
    """A rendered scene."""

    __tablename__ = "scenes"

    job_id: Mapped[str] = mapped_column(String(32))
    summary: Mapped[dict[str, Any]]


class CalibrationRow(Row):
    """Simulations that judge a fit's posterior."""

    __tablename__ = "calibrations"

    fit_id: Mapped[str] = mapped_column(String(32), index=True)
    job_id: Mapped[str] = mapped_column(String(32))
    summary: Mapped[dict[str, Any]]


class PosteriorRow(Row):
    """A sampled posterior of a fit."""

    __tablename__ = "posteriors"

    fit_id: Mapped[str] = mapped_column(String(32), index=True)
    job_id: Mapped[str] = mapped_column(String(32))
    summary: Mapped[dict[str, Any]]


class KeyRow(Row):
    """An API key. Only the hash of its secret is kept. revoked : when it was, None while it is good."""

    __tablename__ = "api_keys"

    name: Mapped[str] = mapped_column(String(255))
    scope: Mapped[str] = mapped_column(String(16))
    hash: Mapped[str] = mapped_column(String(64), unique=True)
    revoked: Mapped[float | None] = mapped_column(Float(53), default=None)


class IdempotencyRow(Base):
    """A POST that named itself, and its answer (``status`` None while it is being made).

    made : the id of what it makes, the same at every attempt. lease : until when (seconds since 1970 by the
    database's clock) whoever works on it has it for itself. fingerprint : of the whole request.
    """

    __tablename__ = "idempotency"

    owner: Mapped[str] = mapped_column(String(64), primary_key=True)
    key: Mapped[str] = mapped_column(String(255), primary_key=True)
    created: Mapped[float] = mapped_column(Float(53), index=True)
    made: Mapped[str] = mapped_column(String(32))
    lease: Mapped[float] = mapped_column(Float(53))
    fingerprint: Mapped[str | None] = mapped_column(String(64), default=None)
    status: Mapped[int | None] = mapped_column(Integer, default=None)
    headers: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True), default=None)
    body: Mapped[bytes | None] = mapped_column(LargeBinary, default=None)


#: Rows that result documents are named by.
RESULTS: tuple[type[Row], ...] = (ModelRow, PosteriorRow, TradeoffRow, CalibrationRow, SceneRow)
