"""``brdf-fitter serve``: the HTTP service and its web page."""

from __future__ import annotations

import argparse

from fitter.cli.screen import Screen
from fitter.cli.verb import Verb


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to listen on (default: 127.0.0.1, this machine only)"
    )
    parser.add_argument("--port", type=int, default=8000, help="port; 0 takes a free one (default: 8000)")
    parser.add_argument(
        "--folder", default="brdf-fitter-data", metavar="DIR",
        help="where tables, results and the database are kept (default: brdf-fitter-data)",
    )  # fmt: skip
    parser.add_argument(
        "--workers", type=int, default=1, metavar="N", help="jobs that run at once (default: 1)"
    )
