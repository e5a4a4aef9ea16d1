"""Models that are at hand: made once of their rows, which never change, the latest few kept."""

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
        self._kept: OrderedDict[str, Any] = OrderedDict()
        self._lock = threading.Lock()

    def open(self, row: ModelRow) -> Any:
        """The model of a row, a :class:`fitter.models.ReflectanceModel`."""
        with self._lock:
            if row.id in self._kept:
                self._kept.move_to_end(row.id)
                return self._kept[row.id]
        model = fitter.models.from_dict(row.document)
        with self._lock:
            self._kept[row.id] = model
            while len(self._kept) > self._count:
                self._kept.popitem(last=False)
        return model
