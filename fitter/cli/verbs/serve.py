"""``brdf-fitter serve``: the HTTP service and its web page."""

from __future__ import annotations

import argparse
import socket
from dataclasses import replace
from pathlib import Path

from fitter.cli.screen import Screen
from fitter.cli.values import output_folder
from fitter.cli.verb import Verb
from fitter.cli.verbs.db import database, place
from fitter.cli.verbs.keys import guards
from fitter.errors import FitError, SpecError


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to listen on (default: 127.0.0.1, this machine only)"
    )
    parser.add_argument("--port", type=int, default=8000, help="port to listen on (default: 8000)")
    place(parser)
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="jobs at once (default: 2)")
    parser.add_argument(
        "--engine", choices=("threads", "dask"), default="threads",
        help="what runs jobs: threads of the server (default), or the processes of a local Dask cluster",
    )  # fmt: skip
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="a Dask scheduler that runs, as tcp://host:8786, instead"
    )
    guards(parser)


def run(given: argparse.Namespace, screen: Screen) -> None:
    if not 1 <= given.workers <= 64:
        raise SpecError(
            f"--workers is {given.workers}", code="bad-call", parameter="workers", remedy="give 1 to 64"
        )
    folder = output_folder(given.folder, "folder")
    _check_address(given.host, given.port)
    # The service is the one part that lives above the library; nothing else here may import it.
    from api.keys import are_needed
    from api.serve import serve
    from api.settings import Settings

    settings = Settings(
        folder=Path(folder), database_url=database(given), storage=given.storage, workers=given.workers,
        engine="dask" if given.scheduler else given.engine, scheduler=given.scheduler,
        requests_per_second=given.requests_per_second, burst=given.burst,
    )  # fmt: skip
    settings = replace(settings, keys=are_needed(given.keys, given.host, settings.url))
    url = f"http://{given.host}:{given.port}"
    if screen.json:
        screen.document({"kind": "brdf-fitter/serving", "url": url, "folder": str(folder.resolve())})
    else:
        screen.line(f"serving {url} from {folder.resolve()}; stop with Ctrl-C")
        screen.stdout.flush()
    try:
        serve(settings, host=given.host, port=given.port)
    except KeyboardInterrupt:
        screen.note("stopped")  # that is how a server ends
    except SystemExit as end:
        if end.code:
            raise FitError(
                "the service could not start", code="serve-failed", remedy="see the messages above"
            ) from end


def _check_address(host: str, port: int) -> None:
    """Say what is wrong with an address before anything is loaded. Raises SpecError."""
    if not 1 <= port <= 65535:
        raise SpecError(f"--port is {port}", code="bad-call", parameter="port", remedy="give 1 to 65535")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        raise SpecError(
            f"can't listen on {host}, port {port}: {error.strerror or error}", code="address-unusable",
            parameter="port", cause="another program listens there, or the address is not this machine's",
            remedy="choose another --port or --host",
        ) from error  # fmt: skip


VERB = Verb("start the HTTP service and its web page", configure, run)
