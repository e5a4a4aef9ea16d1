"""Compressed tables: the container that ``fitter.compress(...).save`` writes."""

from __future__ import annotations

from dataclasses import replace

from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.source import Source
from fitter.table import Table

#: As :data:`fitter.compression.container.MAGIC`; repeated here so that sniffing loads no codec.
MAGIC = b"\x89BRDFfit"


def sniff(head: bytes, size: int) -> float:
    """Sure by the first eight bytes."""
    return 1.0 if head.startswith(MAGIC) else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The unpacked table, with a note that says how far its values may be from the original's."""
    if options.quantity not in (None, "brdf"):
        raise source.error(
            f"a compressed table holds f_r itself, not {options.quantity}", "table-quantity",
            parameter="quantity", remedy="leave quantity out",
        )  # fmt: skip
    from fitter.compression import CompressedTable

    small = CompressedTable.from_bytes(source.data, source.name)
    table = small.decompress()
    metadata = table.metadata
    if small.tolerance > 0:
        floors = ", ".join(f"{floor:.3g}" for floor in small.floor)
        note = (
            f"unpacked from a compressed table: every value is within {small.tolerance:g} x (|f| + floor) "
            f"of the measured one, floor {floors} 1/sr"
        )
        metadata = replace(metadata, notes=(*metadata.notes, note))
    table.metadata = replace(metadata, name=options.name) if options.name else metadata
    return [table]


FORMAT = Format(
    name="compressed",
    description="A table compressed by this program, with its stated error bound.",
    conventions=(),
    sniff=sniff,
    read=read,
)
