"""The page over loopback: how soon it can be used, and what each view of a MERL-size table takes."""

from __future__ import annotations

import struct
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np

from api.client import Client
from tests.api.browser import LAPTOP, opened
from tests.bench.measuring import Figure, Row, Size
from tests.bench.service import served

SEED = 10
#: What the page asks for, {} for an incidence of its own each time.
VIEWS = {
    "an in-plane slice of 359 directions": "slices?n=359&theta_i_deg={}",
    "a lobe, 3 degrees between nodes": "lobe?theta_i_deg={}",
    "the image over half and difference angle": "half-difference",
    "coverage": "coverage",
    "in-plane samples of six incidences": "cuts",
}


def run(size: Size) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as name, served(Path(name)) as (url, _):
        yield _first_view(url, size)
        yield from _views(url, size)


def _first_view(url: str, size: Size) -> Row:
    """From the request to the list of measurements, in a browser that has seen nothing yet."""
    page_seconds: list[float] = []
    least: list[float] = []
    with opened() as browser:
        for _ in range(size.pick(7, 1)):
            for seconds, path, there in (
                (page_seconds, "", "#panel-table .list :text('None yet.')"), (least, "/healthz", "pre"),
            ):  # fmt: skip
                context = browser.new_context(viewport=LAPTOP)
                page = context.new_page()
                began = time.perf_counter()
                page.goto(url + path)
                page.locator(there).wait_for()
                seconds.append(time.perf_counter() - began)
                context.close()
    return Row(
        "the page's first view in Chromium", Figure.of("GET /, usable", "s", page_seconds),
        (Figure.of("floor: GET /healthz there", "s", least),),
    )  # fmt: skip


def _views(url: str, size: Size) -> Iterator[Row]:
    shape = size.pick((90, 90, 180), (10, 10, 20))
    cells = int(np.prod(shape))
    rng = np.random.default_rng(SEED)
    content = struct.pack("<3i", *shape) + rng.lognormal(-1, 1, 3 * cells).tobytes()
    with Client(url) as client:
        table = client.upload(content).id
    for case, path in VIEWS.items():
        view = f"{url}/v1/tables/{table}/{path}"
        seconds: list[float] = []
        least: list[float] = []
        sent = 0
        with httpx.Client(timeout=120) as asking:
            for theta in rng.uniform(0, 85, size.pick(31, 3)):
                for times, address in ((seconds, view.format(theta)), (least, f"{url}/healthz")):
                    began = time.perf_counter()
                    answer = asking.get(address)
                    times.append(time.perf_counter() - began)
                    assert answer.status_code == 200
                    sent = max(sent, len(answer.content))
        # The first call looks at every sample, or parses the table: it is told apart.
        yield Row(
            f"{case}, of a table of {cells:,} cells",
            Figure.of(f"GET /v1/tables/ID/{path.partition('?')[0]}", "s", seconds[1:]),
            (Figure.of("floor: GET /healthz", "s", least[1:]),),
            {"first_seconds": seconds[0], "bytes": sent, "cells": cells}, SEED,
        )  # fmt: skip
