"""Assembly: geometry and values as a file holds them to a Table in 1/sr, without the cosine."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.errors import TableError
from fitter.formats.fills import find_fills
from fitter.formats.geometry import Geometry
from fitter.formats.read_options import ReadOptions
from fitter.formats.source import Source
from fitter.grid import Grid
from fitter.metadata import Channel, Metadata, Quantity, Symmetry
from fitter.table import Table

FloatArray = NDArray[np.float64]

QUANTITY_REMEDY = (
    "say which it is with quantity='brdf' (1/sr, no cosine), 'ccbrdf' (brdf times cos theta_o) or "
    "'reflectance_factor' (pi times brdf)"
)

#: The note of a table that was given so.
ABOUT_SPECULAR = "Directions came as polar coordinates about the specular one, azimuth 0 towards the normal."
#: The note of a table whose channels are X, Y, Z.
TRISTIMULUS = "The channels are CIE tristimulus values, not spectral bands."


@dataclass(frozen=True)
class Reading:
    """What a reader found out about one table, before conversion.

    value, sigma : (n, C) as in the file, in ``quantity``. usable : (n,) or None. filled : (n,) what the
    format itself marks as fill values, or None.
    angle_unit : of the file's angles, "deg" or "rad"; "" where it holds none.
    statements : what the file says beside the samples (scale_uncertainty, aperture, ...; radians).
    text : whether the file is text, of which an open last line may mean that it is cut off.
    """

    source_format: str
    quantity: Quantity
    value: FloatArray
    channels: Sequence[Channel]
    sigma: FloatArray | None = None
    usable: NDArray[np.bool_] | None = None
    filled: NDArray[np.bool_] | None = None
    symmetry: Symmetry | None = None
    name: str = ""
    item: str | None = None
    angle_unit: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict[str, Any])
    statements: Mapping[str, float] = field(default_factory=dict[str, float])
    notes: tuple[str, ...] = ()
    text: bool = True


def assemble(
    source: Source,
    options: ReadOptions,
    reading: Reading,
    geometry: Geometry,
    grid: tuple[Grid, NDArray[np.intp]] | None = None,
    copy: bool = True,
) -> Table:
    """The Table of a reading: values converted to f_r, rows put in the grid's order where there is one.

    copy : False where the directions of ``geometry`` are this table's alone.
    Raises TableError, with the file's name, where nothing is usable.
    """
    notes = [*reading.notes, *geometry.notes]
    cos_o = geometry.wo[:, 2]
    value = to_brdf(reading.value, reading.quantity, cos_o)
    sigma = None if reading.sigma is None else to_brdf(reading.sigma, reading.quantity, cos_o)
    if reading.quantity == "ccbrdf" and (cos_o == 0).any():
        notes.append(
            f"{int((cos_o == 0).sum())} rows lie on the horizon, where a cosine-weighted value gives no "
            "BRDF: they count as missing."
        )
    fills = None
    if options.fills != "keep":
        found = find_fills(
            reading.value, reading.quantity, geometry.wi, geometry.wo, stated=reading.filled,
            floors=options.fills == "floors",
        )  # fmt: skip
        fills = found.rows if found.rows.any() else None
        notes += found.notes
    kept = np.ones(len(value), bool) if reading.usable is None else reading.usable
    kept = kept if fills is None else kept & ~fills
    zeros = sum(int(np.count_nonzero((column == 0) & kept)) for column in value.T)
    if zeros:
        notes.append(f"{zeros} values are exactly 0: measured, unless the source writes 0 for missing.")
    if reading.text and not source.ends_in_newline:
        notes.append("The last line has no line end: check that the file is whole.")
    one = _common_incidence(geometry)
    if len(value) == 1:
        notes.append("The table holds one sample: no model can be told from another by it.")
    elif one:
        notes.append("The table holds one incidence only: what it says about others is extrapolated.")
    usable = reading.usable
    if grid is not None:
        order = grid[1]
        value = value[order]
        sigma = None if sigma is None else sigma[order]
        usable = None if usable is None else usable[order]
        fills = None if fills is None else fills[order]
    directions = {} if grid is not None else {"wi": geometry.wi, "wo": geometry.wo}
    return build(
        source, options, reading, geometry.convention, notes, value=value, sigma=sigma, mask=usable,
        fills=fills, grid=None if grid is None else grid[0], symmetric=geometry.symmetric, copy=copy,
        **directions,
    )  # fmt: skip


def build(
    source: Source,
    options: ReadOptions,
    reading: Reading,
    convention: str,
    notes: Sequence[str],
    *,
    symmetric: bool,
    **arrays: Any,
) -> Table:
    """A Table of converted ``arrays`` with the metadata of ``reading``; its errors name the file."""
    provenance = dict(reading.provenance)
    if source.name:
        provenance["file"] = source.name
    if reading.item is not None:
        provenance["item"] = reading.item
    name = options.name or reading.name or source.stem or reading.source_format
    metadata = Metadata(
        name=f"{name} [{reading.item}]" if reading.item is not None else name,
        source_format=reading.source_format, quantity=reading.quantity, convention=convention,
        angle_unit=reading.angle_unit, sha256=source.digest,
        scale_uncertainty=reading.statements.get("scale_uncertainty"),
        angle_uncertainty=reading.statements.get("angle_uncertainty"),
        aperture=reading.statements.get("aperture"), provenance=provenance, notes=tuple(notes),
    )  # fmt: skip
    try:
        table = Table(
            channels=reading.channels, symmetry=reading.symmetry or ("isotropic" if symmetric else None),
            metadata=metadata, negatives=options.negatives, duplicates=options.duplicates, **arrays,
        )  # fmt: skip
    except TableError as error:
        error.file = source.name
        raise
    source.begin_digest()
    return table


def of_several(table: Table, sources: Sequence[Source], name: str) -> Table:
    """``table`` with the metadata of a measurement read from several files."""
    names = [source.name for source in sources if source.name]
    digest = hashlib.sha256("".join(source.sha256 for source in sources).encode()).hexdigest()
    provenance = {**table.metadata.provenance, "files": names}
    provenance.pop("file", None)
    table.metadata = replace(table.metadata, name=name, sha256=digest, provenance=provenance)
    return table


def stated_quantity(options: ReadOptions, stated: Quantity, words: str) -> tuple[Quantity, list[str]]:
    """The quantity to read, and a note where ``quantity=`` overrides what the file says in ``words``."""
    if options.quantity is None or options.quantity == stated:
        return stated, []
    return options.quantity, [f"The file says {words}; its values were read as {options.quantity}."]


def to_brdf(value: FloatArray, quantity: Quantity, cos_o: FloatArray) -> FloatArray:
    """f_r in 1/sr of values (n, C) in ``quantity`` at cos theta_o (n,); NaN where the cosine is 0."""
    if quantity == "brdf":
        return value
    if quantity == "reflectance_factor":
        return value / np.pi
    cosine = np.abs(np.where(cos_o == 0, np.nan, cos_o))
    with np.errstate(over="ignore", invalid="ignore"):
        return value / cosine[:, None]


def _common_incidence(geometry: Geometry) -> bool:
    def span(wi: FloatArray) -> float:
        known = wi[np.isfinite(wi).all(axis=1), 2 if geometry.symmetric else slice(None)]
        return float(np.ptp(known, axis=0).max()) if len(known) else np.inf

    # Where some rows differ, not all need be looked at.
    return not 1e-6 <= span(geometry.wi[:1000]) < np.inf and span(geometry.wi) < 1e-6
