"""How Alembic runs the migrations: on the connection that it is given, inside its transaction."""

from __future__ import annotations

from alembic import context

from api.rows import Base

context.configure(
    connection=context.config.attributes["connection"], target_metadata=Base.metadata, transactional_ddl=True
)
context.run_migrations()
