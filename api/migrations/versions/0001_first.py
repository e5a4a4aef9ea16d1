"""Tables, jobs, models, posteriors, tradeoffs and calibrations, as they were before there were migrations.

Earlier versions made what was missing whenever they started, so a database may hold all of these or a part.
"""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    there = set(sa.inspect(op.get_bind()).get_table_names())
    job_id, summary = ("job_id", sa.String(32)), ("summary", sa.JSON())
    made: dict[str, list[tuple[str, Any]]] = {
        "tables": [
            ("name", sa.String(255)), ("sha256", sa.String(64)), ("size", sa.BigInteger()),
            ("options", sa.JSON()), ("description", sa.JSON()),
        ],
        "jobs": [
            ("kind", sa.String(16)), ("state", sa.String(16)), ("request", sa.JSON()),
            ("table_id", sa.String(32)), ("attempt", sa.Integer()), ("cancel", sa.Boolean()),
            ("share", sa.Float(53)), ("what", sa.String(255)), ("started", sa.Float(53)),
            ("finished", sa.Float(53)), ("results", sa.JSON()), ("problem", sa.JSON()),
        ],
        "models": [
            ("origin", sa.String(16)), ("name", sa.String(255)), ("document", sa.JSON()),
            ("table_id", sa.String(32)), job_id, summary,
        ],
        "posteriors": [("fit_id", sa.String(32)), job_id, summary],
        "tradeoffs": [("table_id", sa.String(32)), job_id, summary],
        "calibrations": [("fit_id", sa.String(32)), job_id, summary],
    }  # fmt: skip
    empty = {"jobs": {"started", "finished", "problem"}, "models": {"table_id", "job_id", "summary"}}
    indexed = {
        "tables": ["sha256"], "jobs": ["table_id"], "models": ["origin", "table_id"],
        "posteriors": ["fit_id"], "calibrations": ["fit_id"],
    }  # fmt: skip
    for table, columns in made.items():
        if table in there:
            continue
        op.create_table(
            table, sa.Column("id", sa.String(32), primary_key=True),
            sa.Column("created", sa.Float(53), nullable=False),
            *(sa.Column(name, kind, nullable=name in empty.get(table, ())) for name, kind in columns),
        )  # fmt: skip
        for name in ["created", *indexed.get(table, [])]:
            op.create_index(f"ix_{table}_{name}", table, [name])
    if "jobs" not in there:
        op.create_index("jobs_by_state", "jobs", ["state", "created"])
