"""Parsed tables: from a row and its blob, the latest few kept in memory."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import orjson
from numpy.typing import NDArray

import fitter
from api.blobs import Blobs
from api.rows import TableRow
from fitter.errors import TableError
from fitter.formats.read_options import read_options
from fitter.formats.source import Source
from fitter.views import Views

if TYPE_CHECKING:
    from fitter.sampling import Samples, TableSampler
    from fitter.sampling.envelope import Method

FloatArray = NDArray[np.float64]


def parse(data: bytes | memoryview, options: dict[str, Any], sha256: str) -> fitter.Table:
    """The table in uploaded bytes, whose sha256 is known. Raises TableError or SpecError as
    :func:`fitter.load` does."""
    chosen = read_options(options)
    try:
        source = Source(data, chosen.name)
        source.digest = sha256
        return fitter.load(source, **chosen.to_dict())
    except TableError as error:
        error.file = error.file or chosen.name or "the upload"
        raise


class Opened:
    """A parsed table, what was looked at of it, and its sampler once somebody drew from it."""

    def __init__(self, table: fitter.Table) -> None:
        self.table = table
        self.views = Views(table)
        self._lock = threading.Lock()
        self._sampler: TableSampler | None = None

    def sample(
        self,
        wi: FloatArray | None,
        n: int,
        seed: int,
        *,
        weights: Sequence[float] | None = None,
        method: Method | None = None,
        max_evaluations: int | None = None,
        allow_extrapolated: bool = False,
    ) -> tuple[Samples, list[dict[str, Any]] | None]:
        """Draws from the table, of pairs where ``wi`` is None, and what is known of each incidence.

        The lock is there because a sampler keeps envelopes from call to call. A request must end: an
        acceptance below a twentieth is an error unless more candidates were asked for.
        """
        draws = n * (len(wi) if wi is not None and wi.ndim == 2 else 1)
        most = 20 * draws + 1_000_000 if max_evaluations is None else max_evaluations

        def drawn(sampler: TableSampler) -> tuple[Samples, list[dict[str, Any]] | None]:
            if wi is None:
                return sampler.sample_pairs(n, seed, max_evaluations=most), None
            found = sampler.sample(wi, n, seed, allow_extrapolated=allow_extrapolated, max_evaluations=most)
            return found, sampler.slices(wi, allow_extrapolated=allow_extrapolated)

        if weights is not None or method is not None:
            return drawn(fitter.TableSampler(self.table, weights=weights, method=method))
        with self._lock:
            if self._sampler is None:
                self._sampler = fitter.TableSampler(self.table)
            return drawn(self._sampler)


class OpenTables:
    """The ``count`` most recently used parsed tables."""

    def __init__(self, blobs: Blobs, count: int) -> None:
        self._blobs = blobs
        self._count = count
        self._kept: OrderedDict[bytes, Opened] = OrderedDict()
        self._lock = threading.Lock()

    def open(self, row: TableRow) -> Opened:
        """The table of a row, parsed again only when it has left the memory."""
        key = orjson.dumps([row.sha256, row.options], option=orjson.OPT_SORT_KEYS)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        opened = Opened(parse(self._blobs.read(row.sha256), row.options, row.sha256))
        with self._lock:
            # Two requests may have parsed at once: the first one's table, with its sampler, stays.
            opened = self._kept.setdefault(key, opened)
            self._kept.move_to_end(key)
            while len(self._kept) > self._count:
                self._kept.popitem(last=False)
        return opened
