"""Models that are at hand: made once of their rows, which never change or go, the latest few kept."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any

import fitter
from api.rows import ModelRow


class OpenModels:
    """The ``count`` most recently used models."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._kept: OrderedDict[str, tuple[str, Any]] = OrderedDict()
        self._lock = threading.Lock()

    def kept(self, id: str) -> tuple[str, Any] | None:
        """Owner and model where it is at hand: its row is looked for in the time of 40,000 evaluations."""
        with self._lock:
            if id not in self._kept:
                return None
            self._kept.move_to_end(id)
            return self._kept[id]

    def open(self, row: ModelRow) -> Any:
        """The model of a row, a :class:`fitter.models.ReflectanceModel`."""
        model = fitter.models.from_dict(row.document)
        with self._lock:
            self._kept[row.id] = row.owner, model
            while len(self._kept) > self._count:
                self._kept.popitem(last=False)
        return model
