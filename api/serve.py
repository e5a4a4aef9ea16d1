"""Serving: one process on one data folder, stopped gracefully."""

from __future__ import annotations

from types import FrameType

import uvicorn
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from api import logs
from api.app import create_app
from api.problems import MEDIA_TYPE, document, encoded
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


class _Protocol(HttpToolsProtocol):
    """Answers with a problem document also to bytes that are no HTTP, which never reach the application."""

    def send_400_response(self, msg: str) -> None:
        told = document(
            400, "bad-http", "the bytes are no HTTP request", cause="who sends them speaks something else",
            remedy="send HTTP/1.1, and TLS only to what ends it in front of this server",
        )  # fmt: skip
        body = encoded(told)
        head = f"HTTP/1.1 400 Bad Request\r\nContent-Type: {MEDIA_TYPE}\r\nContent-Length: {len(body)}"
        self.transport.write(f"{head}\r\nConnection: close\r\n\r\n".encode() + body)
        self.transport.close()


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
        timeout_graceful_shutdown=CONNECTION_GRACE, http=_Protocol,
    )  # fmt: skip
    _Server(config).run()
