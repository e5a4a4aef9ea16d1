"""Rendered scenes."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    op.create_table(
        "scenes", sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("created", sa.Float(53), nullable=False),
        sa.Column("owner", sa.String(64), nullable=False, server_default=""),
        sa.Column("job_id", sa.String(32), nullable=False), sa.Column("summary", sa.JSON(), nullable=False),
    )  # fmt: skip
    for name in ("created", "owner"):
        op.create_index(f"ix_scenes_{name}", "scenes", [name])
