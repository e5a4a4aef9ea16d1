"""Settings: where the service keeps its data, and what it refuses."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from api.place import Place


@dataclass(frozen=True)
class Settings:
    """What one server is told when it starts.

    folder : the data folder; blobs, results, the default database and the compilation cache live in it.
    database_url : any SQLAlchemy URL; None is SQLite in the data folder.
    storage : of blobs and results, a folder or an fsspec URL; None is the data folder.
    engine : what does the jobs' work: "threads" of this process, or "dask".
    scheduler : the address of a Dask scheduler; None starts one here, with workers.
    workers : jobs that run at once.
    max_upload_bytes, max_body_bytes : of one uploaded table, and of any other request's body.
    parsers : uploads that are read at once.
    max_parse_bytes, max_parse_seconds : what reading one upload may take of memory and time.
    max_samples, max_channels : of one table.
    max_pairs : direction pairs in one evaluation.
    max_albedo_directions : directions in one albedo request (each is a quadrature of its own).
    max_draws : draws in one request for samples.
    max_walkers, max_kept_draws, max_budget_seconds : of one posterior: walkers of all its ensembles, draws
        kept, and the time that bounds its steps; the last is also the most that a calibration may take.
    max_queue : jobs that may wait; more are refused with 429.
    max_attempts : times who works on a job may die before it is given up; when servers die that did not work
        on it, it is given up after ten times as many starts.
    lease_seconds : how long a claim holds without being renewed; a job of a dead server waits this long.
    keys : whether requests need an API key.
    requests_per_second, burst : of one key, or address where no keys are needed; 0 is no limit.
    cached_tables, cached_models : parsed tables, and models, kept in memory.
    grace_seconds : how long a stopping server waits for its jobs to reach a safe point.
    """

    folder: Path
    database_url: str | None = field(default=None, repr=False)
    storage: str | None = None
    engine: Literal["threads", "dask"] = "threads"
    scheduler: str | None = None
    workers: int = 2
    max_upload_bytes: int = 256 << 20
    max_body_bytes: int = 64 << 20
    parsers: int = 2
    max_parse_bytes: int = 4 << 30
    max_parse_seconds: float = 120.0
    max_samples: int = 20_000_000
    max_channels: int = 1000
    max_pairs: int = 1_000_000
    max_albedo_directions: int = 1000
    max_draws: int = 1_000_000
    max_walkers: int = 4096
    max_kept_draws: int = 200_000
    max_budget_seconds: float = 14_400.0
    max_queue: int = 1000
    max_attempts: int = 3
    lease_seconds: float = 30.0
    keys: bool = False
    requests_per_second: float = 0.0
    burst: int = 200
    cached_tables: int = 4
    cached_models: int = 256
    grace_seconds: float = 10.0

    @property
    def place(self) -> Place:
        """Where everything is."""
        folder = self.folder.resolve()
        return Place(folder, self.url, self.storage or str(folder))

    @property
    def url(self) -> str:
        """The database's URL."""
        return self.database_url or f"sqlite:///{self.folder.resolve() / 'service.sqlite'}"
