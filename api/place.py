"""Place: where a service keeps everything, which is all that a worker elsewhere has to know."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Place:
    """folder : of this machine, or of all that share it. database : its URL, never shown, since it may hold a
    password. storage : of blobs and results, a folder or an fsspec URL."""

    folder: Path
    database: str = field(repr=False)
    storage: str

    @property
    def programs(self) -> Path:
        """Where compiled programs are kept between processes."""
        return self.folder / "xla"
