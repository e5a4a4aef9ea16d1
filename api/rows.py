"""Rows: what the database holds."""

from __future__ import annotations

from typing import Any

from sqlalchemy import JSON, BigInteger, Boolean, Float, Index, Integer, String
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

#: States a job may be in; the last three are final.
QUEUED, RUNNING, DONE, FAILED, CANCELLED = "queued", "running", "done", "failed", "cancelled"
FINAL = (DONE, FAILED, CANCELLED)


class Row(DeclarativeBase):
    """Every row: a random id (32 hexadecimal digits) and when it was made (seconds since 1970, UTC)."""

    type_annotation_map = {dict[str, Any]: JSON, list[Any]: JSON}  # noqa: RUF012 (SQLAlchemy's own idiom)

    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    created: Mapped[float] = mapped_column(Float(53), index=True)


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

    ``table_id`` is empty where the work needs no table.
    """

    __tablename__ = "jobs"
    __table_args__ = (Index("jobs_by_state", "state", "created"),)

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
