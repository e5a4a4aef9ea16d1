"""Leases of running jobs, and the log of what became of each job."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"

_JOBS = sa.table(
    "jobs", *(sa.column(name, sa.JSON() if name in ("results", "problem") else None) for name in (
        "id", "created", "state", "attempt", "share", "what", "started", "finished", "results", "problem",
        "events",
    )),
)  # fmt: skip
_SHOWN = ("state", "attempt", "share", "what", "started", "finished", "results", "problem")


def upgrade() -> None:
    op.add_column("jobs", sa.Column("server", sa.String(64)))
    op.add_column("jobs", sa.Column("worker", sa.String(255)))
    op.add_column("jobs", sa.Column("lease", sa.Float(53)))
    for name in ("losses", "events"):
        op.add_column("jobs", sa.Column(name, sa.Integer(), nullable=False, server_default="0"))
    op.create_index("jobs_by_lease", "jobs", ["state", "lease"])
    log = op.create_table(
        "job_events", sa.Column("job_id", sa.String(32), primary_key=True),
        sa.Column("seq", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("created", sa.Float(53), nullable=False), sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("data", sa.JSON(), nullable=False),
    )  # fmt: skip
    # What an earlier version left: one event for each job, which says how it is.
    rows = op.get_bind().execute(sa.select(_JOBS)).mappings().all()
    final = ("done", "failed", "cancelled")
    for row in rows:
        kind = row["state"] if row["state"] in final else "progress"
        data = {name: row[name] for name in _SHOWN}
        op.get_bind().execute(
            log.insert().values(job_id=row["id"], seq=1, created=row["created"], kind=kind, data=data)
        )
    op.execute(sa.update(_JOBS).values(events=1))
    # Whoever ran a job then holds no lease: it is claimed again, as a job whose lease has lapsed.
    op.execute(sa.text("UPDATE jobs SET lease = 0 WHERE state = 'running'"))
