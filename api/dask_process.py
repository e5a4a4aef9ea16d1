"""``python -m api.dask_process``: a scheduler or a worker of the local cluster, in a process of its own.

It ends when its standard input does: that is how it learns that the server died, however that died.
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import os
import sys
import threading
from typing import Any

import dask.config
from distributed import Scheduler, Worker

HOST = "127.0.0.1"


def _end_with_the_server() -> None:
    def wait() -> None:
        sys.stdin.buffer.read()
        os._exit(0)

    threading.Thread(target=wait, daemon=True).start()


async def _serve(given: argparse.Namespace) -> None:
    node: Any
    if given.scheduler is None:
        node = Scheduler(host=HOST, port=0, dashboard=False, dashboard_address=f"{HOST}:0")
    else:
        node = Worker(
            given.scheduler, host=HOST, nthreads=1, memory_limit=0, local_directory=given.folder,
            dashboard=False,
        )  # fmt: skip
    async with node:
        print(node.address, flush=True)
        await node.finished()


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m api.dask_process", description=__doc__)
    parser.add_argument("--scheduler", help="be a worker of this scheduler")
    parser.add_argument("--folder", help="what a worker has to put on the disk goes here")
    given = parser.parse_args()
    _end_with_the_server()
    # A task whose worker died is ours to start again, under the next attempt.
    dask.config.set({"distributed.scheduler.allowed-failures": 0})
    logging.getLogger("distributed").setLevel(logging.ERROR)
    try:
        asyncio.run(_serve(given))
    finally:
        # A worker that lost its scheduler: whatever its thread still computes is nobody's.
        os._exit(0)


if __name__ == "__main__":
    main()
