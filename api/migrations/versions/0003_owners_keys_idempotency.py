"""Whose each row is, API keys, and the answers to requests that name themselves."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    for table in ("tables", "jobs", "models", "posteriors", "tradeoffs", "calibrations"):
        op.add_column(table, sa.Column("owner", sa.String(64), nullable=False, server_default=""))
        op.create_index(f"ix_{table}_owner", table, ["owner"])
    op.create_table(
        "api_keys", sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("created", sa.Float(53), nullable=False),
        sa.Column("owner", sa.String(64), nullable=False, server_default=""),
        sa.Column("name", sa.String(255), nullable=False), sa.Column("scope", sa.String(16), nullable=False),
        sa.Column("hash", sa.String(64), nullable=False, unique=True), sa.Column("revoked", sa.Float(53)),
    )  # fmt: skip
    for name in ("created", "owner"):
        op.create_index(f"ix_api_keys_{name}", "api_keys", [name])
    op.create_table(
        "idempotency", sa.Column("owner", sa.String(64), primary_key=True),
        sa.Column("key", sa.String(255), primary_key=True),
        sa.Column("created", sa.Float(53), nullable=False),
        sa.Column("made", sa.String(32), nullable=False), sa.Column("lease", sa.Float(53), nullable=False),
        sa.Column("fingerprint", sa.String(64)), sa.Column("status", sa.Integer()),
        sa.Column("headers", sa.JSON()), sa.Column("body", sa.LargeBinary()),
    )  # fmt: skip
    op.create_index("ix_idempotency_created", "idempotency", ["created"])
