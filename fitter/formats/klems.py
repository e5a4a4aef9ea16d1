"""WINDOW's BSDF XML (Klems matrices): values over patches of the hemisphere, layer by layer and side by side.

The incident azimuth is that of the light's travel, so that straight transmission and mirror reflection are on
the matrix' diagonal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter.formats import geometry as geo
from fitter.formats.assemble import Reading, assemble, stated_quantity
from fitter.formats.klems_basis import Basis, declared_basis, known_basis
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.source import Source
from fitter.formats.text import number
from fitter.formats.window_xml import (
    MIRRORED,
    Block,
    Layer,
    Side,
    by_side,
    in_order,
    is_window,
    item_of,
    layers_of,
    provenance_of,
)
from fitter.formats.xml_tree import Element
from fitter.metadata import Channel
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "klems"
CONVENTIONS = ("phi_specular_0", "phi_specular_180")


def sniff(head: bytes, size: int) -> float:
    """Sure of an XML text whose root is a WindowElement."""
    return 0.98 if is_window(head) else 0.0


@dataclass(frozen=True)
class _Matrix:
    """Reflection at one wavelength: values (incident, outgoing) over the patches of two bases."""

    incident: Basis
    outgoing: Basis
    values: FloatArray


def read(source: Source, options: ReadOptions) -> list[Table]:
    """A table for each layer and side that has reflection blocks. Transmission is skipped, with a note."""
    layers, notes = layers_of(source)
    bases: dict[int, Mapping[str, Basis]] = {layer.number: _bases(source, layer) for layer in layers}
    sides = by_side(source, layers, lambda layer, block: _block(source, layer, block, bases[layer.number]))
    return [
        _table(source, options, layer, side, matrices, item_of(layer, side, sides), notes)
        for layer, side, matrices in sides
    ]


FORMAT = Format(NAME, "WINDOW BSDF XML, Klems matrices over patches", CONVENTIONS, sniff, read)


def _bases(source: Source, layer: Layer) -> dict[str, Basis]:
    """The angle bases a layer declares, by name in lower case."""
    definition = layer.element.first("DataDefinition")
    if definition is None or layer.structure.lower() not in ("columns", "rows"):
        raise source.error(
            f"IncidentDataStructure is {layer.structure[:40]!r}", "table-header", row=layer.element.row,
            column="IncidentDataStructure", cause="a damaged header", remedy="write Columns or Rows",
        )  # fmt: skip
    declared = [declared_basis(source, element) for element in definition.all("AngleBasis")]
    return {basis.name.lower(): basis for basis in declared}


def _block(source: Source, layer: Layer, block: Block, bases: Mapping[str, Basis]) -> _Matrix:
    """A block's matrix. Its ScatteringDataType is no help: Radiance writes BTDF always."""
    pair: list[Basis] = []
    for key in ("RowAngleBasis", "ColumnAngleBasis"):
        name = block.element.words(key)
        pair.append(bases.get(name.lower()) or known_basis(source, name, block.element.row))
    matrix = _matrix(source, block.element, len(pair[0]), len(pair[1]))
    outgoing, incident = pair
    if layer.structure.lower() == "rows":
        return _Matrix(outgoing, incident, matrix)
    return _Matrix(incident, outgoing, matrix.T)


def _matrix(source: Source, block: Element, rows: int, columns: int) -> FloatArray:
    data = block.first("ScatteringData")
    words = [] if data is None else data.text.replace(",", " ").split()
    row = block.row if data is None else data.row
    if len(words) != rows * columns:
        raise source.error(
            f"ScatteringData has {len(words):,} values and its angle bases ask for {rows} x {columns}",
            "table-truncated", row=row, column="ScatteringData",
            cause="values are missing, or the basis is another",
            remedy="fetch the file again, or declare its AngleBasis",
        )  # fmt: skip
    values = [number(word) for word in words]
    if None in values:
        raise source.error(
            f"{words[values.index(None)][:40]!r} is not a number", "table-not-a-number", row=row,
            column="ScatteringData", remedy="mend the value, or write nan where nothing was measured",
        )  # fmt: skip
    return np.asarray(values, np.float64).reshape(rows, columns)


def _table(
    source: Source, options: ReadOptions, layer: Layer, side: Side, matrices: Mapping[Channel, _Matrix],
    item: str | None, notes: list[str],
) -> Table:  # fmt: skip
    channels, found, said = in_order(matrices)
    first = found[0]
    if any(one.incident is not first.incident or one.outgoing is not first.outgoing for one in found):
        raise source.error(
            f"the {side} reflection is on different angle bases at different wavelengths", "table-header",
            row=layer.element.row, column="ColumnAngleBasis", remedy="keep one basis in a file",
        )  # fmt: skip
    quantity, notes_of = stated_quantity(options, "brdf", "BRDF")
    convention = options.convention or CONVENTIONS[0]
    # The file's frame has its +z at the back: seen from the front, azimuths run the other way.
    sign = -1.0 if side == "front" else 1.0
    turn = np.pi if convention == "phi_specular_0" else 0.0
    n, m = len(first.incident), len(first.outgoing)
    angles = {
        "theta_i": np.repeat(np.deg2rad(first.incident.theta), m),
        "phi_i": np.repeat(sign * np.deg2rad(first.incident.phi), m) + turn,
        "theta_o": np.tile(np.deg2rad(first.outgoing.theta), n),
        # The reader of angles turns the outgoing azimuth under phi_specular_0, which this undoes.
        "phi_o": np.tile(sign * np.deg2rad(first.outgoing.phi), n) - turn,
    }
    geometry = geo.from_angles(source, angles, convention)
    names = [first.incident.name, first.outgoing.name]
    notes_of += [
        *notes,
        f"Values are averages over the patches of {names[0]} (incident) and {names[1]} (outgoing): "
        "directions are their centres.",
    ]
    if side == "front":
        notes_of.append(MIRRORED)
    reading = Reading(
        NAME, quantity, np.stack([one.values.reshape(-1) for one in found], axis=1), channels,
        name=layer.element.words("Material", "Name"), item=item, notes=(*notes_of, *said),
        angle_unit="deg",
        provenance={**provenance_of(layer, side), "basis": names},
    )  # fmt: skip
    return assemble(source, options, reading, geometry)
