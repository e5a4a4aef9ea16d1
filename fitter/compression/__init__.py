"""Tables made smaller with a stated, checked error bound."""

from __future__ import annotations

from fitter.compression.compressed import CompressedTable, compress

__all__ = ["CompressedTable", "compress"]
