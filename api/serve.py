"""Serving: one process on one data folder, stopped gracefully."""

from __future__ import annotations

from types import FrameType

import uvicorn

from api import logs
from api.app import create_app
from api.service import Service, check_folder, check_parts
from api.settings import Settings
from fitter import _jax

#: Seconds that open connections get to finish once the server is asked to stop.
CONNECTION_GRACE = 5


class _Server(uvicorn.Server):
    """Tells the service at once that it is asked to stop, so that event streams end."""

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        service: Service | None = getattr(self.config.app.state, "service", None)  # type: ignore[union-attr]
        if service is not None:
            service.stopping.set()
        super().handle_exit(sig, frame)


def serve(settings: Settings, *, host: str = "127.0.0.1", port: int = 8000, log_level: str = "info") -> None:
    """Serve until interrupted. Compiled programs are kept in the folder.

    Raises SpecError when another server works on it, when the database or the storage can't be used, and when
    something is not installed.
    """
    check_folder(settings)
    check_parts(settings)
    logs.configure(log_level)
    _jax.compile_sooner()
    _jax.use_compilation_cache(settings.place.programs)
    config = uvicorn.Config(
        create_app(settings), host=host, port=port, log_config=None, access_log=False, server_header=False,
        timeout_graceful_shutdown=CONNECTION_GRACE,
    )  # fmt: skip
    _Server(config).run()
