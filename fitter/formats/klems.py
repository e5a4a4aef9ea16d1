"""WINDOW's BSDF XML (Klems matrices): values over patches of the hemisphere, layer by layer and side by side.

Layout and directions are those that Radiance writes and reads (genBSDF, bsdf2klems). Both sides share one
frame, whose +z is the *back* (the room); the incident azimuth is that of the light's travel, so that straight
transmission and mirror reflection are on the matrix' diagonal.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from fitter.formats import geometry as geo
from fitter.formats.assemble import TRISTIMULUS, Reading, assemble, stated_quantity
from fitter.formats.columns import band_nm
from fitter.formats.klems_basis import Basis, declared_basis, known_basis
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.source import Source
from fitter.formats.text import number
from fitter.formats.xml_tree import Element, parse_xml
from fitter.table import Channel, Table

FloatArray = NDArray[np.float64]
Side = Literal["front", "back"]

NAME = "klems"
CONVENTIONS = ("phi_specular_0", "phi_specular_180")
_ROOT = re.compile(rb"<(?:\w+:)?WindowElement[\s>]")
_DIRECTION = re.compile(r"(reflection|transmission) (front|back)")
_UNITS = {"nanometer": 1.0, "nm": 1.0, "micron": 1000.0, "micrometer": 1000.0, "um": 1000.0}
#: Wavelength words of the three files' parts that together are CIE X, Y and Z.
_XYZ = ("CIE-X", "Visible", "CIE-Z")
#: Chromaticities that go with a luminance: no reflectance of their own.
_CHROMATICITY = ("CIE-u", "CIE-v")


def sniff(head: bytes, size: int) -> float:
    """Sure of an XML text whose root is a WindowElement."""
    return 0.98 if head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<") and _ROOT.search(head) else 0.0


@dataclass
class _Side:
    """Reflection of one side of one layer: its bases and matrices (incident, outgoing) by channel name."""

    layer: int
    side: Side
    incident: Basis
    outgoing: Basis
    matrices: dict[str, FloatArray] = field(default_factory=dict[str, FloatArray])
    channels: dict[str, Channel] = field(default_factory=dict[str, Channel])


def read(source: Source, options: ReadOptions) -> list[Table]:
    """A table for each layer and side that has reflection blocks. Transmission is skipped, with a note."""
    root = parse_xml(source)
    layers = [layer for optical in root.all("Optical") for layer in optical.all("Layer")]
    if root.name.lower() != "windowelement" or not layers:
        raise source.error(
            "the XML is no WindowElement with an optical layer", "table-header", row=root.row,
            cause="XML of another kind, or a damaged file", remedy="use a BSDF file of WINDOW or Radiance",
        )  # fmt: skip
    sides: list[_Side] = []
    skipped = 0
    notes: list[str] = []
    for k, layer in enumerate(layers):
        found, transmission, chromaticity = _layer(source, k, layer)
        sides += found
        skipped += transmission
        if chromaticity:
            notes.append(f"{chromaticity} blocks hold chromaticities ({', '.join(_CHROMATICITY)}): not read.")
    if not sides:
        raise source.error(
            f"the file holds transmission only ({skipped} blocks)" if skipped
            else "the file holds no scattering data", "table-transmission" if skipped else "table-empty",
            remedy="use a file that has Reflection Front or Reflection Back blocks",
        )  # fmt: skip
    if skipped:
        notes.insert(0, f"{skipped} transmission blocks are in the file: not read.")
    several = len({side.layer for side in sides}) > 1
    tables: list[Table] = []
    for side in sides:
        item = f"layer {side.layer + 1} {side.side}" if several else side.side
        tables.append(
            _table(source, options, layers[side.layer], side, item if len(sides) > 1 else None, notes)
        )
    return tables


FORMAT = Format(NAME, "WINDOW BSDF XML, Klems matrices over patches", CONVENTIONS, sniff, read)


def _layer(source: Source, k: int, layer: Element) -> tuple[list[_Side], int, int]:
    """The sides of a layer that reflect, and how many transmission and chromaticity blocks it has."""
    definition = layer.first("DataDefinition")
    structure = layer.words("DataDefinition", "IncidentDataStructure")
    if structure.lower().startswith("tensortree"):
        raise source.error(
            f"the file holds a tensor tree ({structure[:20]}), which is not read yet", "table-tensor-tree",
            row=layer.row, column="IncidentDataStructure",
            remedy="convert it with Radiance: bsdf2klems tree.xml > klems.xml",
        )  # fmt: skip
    if definition is None or structure.lower() not in ("columns", "rows"):
        raise source.error(
            f"IncidentDataStructure is {structure[:40]!r}", "table-header", row=layer.row,
            column="IncidentDataStructure", cause="a damaged header", remedy="write Columns or Rows",
        )  # fmt: skip
    declared = [declared_basis(source, element) for element in definition.all("AngleBasis")]
    bases = {basis.name.lower(): basis for basis in declared}
    found: dict[Side, _Side] = {}
    transmission = chromaticity = 0
    for data in layer.all("WavelengthData"):
        channel = _channel(data)
        for block in data.all("WavelengthDataBlock"):
            words = block.words("WavelengthDataDirection")
            match = _DIRECTION.fullmatch(" ".join(words.lower().split()))
            if match is None:
                raise source.error(
                    f"WavelengthDataDirection is {words[:40]!r}", "table-header", row=block.row,
                    column="WavelengthDataDirection", cause="a damaged header",
                    remedy="write Reflection or Transmission, then Front or Back",
                )  # fmt: skip
            if match[1] == "transmission":
                transmission += 1
            elif channel.name in _CHROMATICITY:
                chromaticity += 1
            else:
                _block(source, k, block, structure, bases, channel, cast("Side", match[2]), found)
    return list(found.values()), transmission, chromaticity


def _channel(data: Element) -> Channel:
    """The channel of a WavelengthData: a band by its word (Visible, Solar), a line by its wavelength."""
    words = data.words("Wavelength") or "value"
    element = data.first("Wavelength")
    unit = "" if element is None else element.attributes.get("unit", "").lower().rstrip("s")
    value = number(words)
    if value is not None and unit in _UNITS and 0 < value * _UNITS[unit] < 1e9:
        nm = value * _UNITS[unit]
        return Channel(f"{nm:.10g}nm", nm)
    return Channel(words[:80], band_nm(words))


def _block(
    source: Source, k: int, block: Element, structure: str, bases: Mapping[str, Basis], channel: Channel,
    side: Side, found: dict[Side, _Side],
) -> None:  # fmt: skip
    """Add a reflection block to ``found``. Its ScatteringDataType is no help: Radiance writes BTDF always."""
    pair: list[Basis] = []
    for key in ("RowAngleBasis", "ColumnAngleBasis"):
        name = block.words(key)
        pair.append(bases.get(name.lower()) or known_basis(source, name, block.row))
    matrix = _matrix(source, block, len(pair[0]), len(pair[1]))
    outgoing, incident = pair
    if structure.lower() == "rows":
        outgoing, incident = incident, outgoing
    else:
        matrix = matrix.T
    entry = found.setdefault(side, _Side(k, side, incident, outgoing))
    if entry.incident is not incident or entry.outgoing is not outgoing:
        raise source.error(
            f"the {side} reflection is on different angle bases at different wavelengths", "table-header",
            row=block.row, column="ColumnAngleBasis", remedy="keep one basis in a file",
        )  # fmt: skip
    if channel.name in entry.channels:
        raise source.error(
            f"the {side} reflection is given twice for {channel.name[:40]}", "table-header", row=block.row,
            column="Wavelength", remedy="keep one block for each wavelength and direction",
        )  # fmt: skip
    entry.matrices[channel.name], entry.channels[channel.name] = matrix, channel


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
    source: Source, options: ReadOptions, layer: Element, side: _Side, item: str | None, notes: list[str]
) -> Table:
    quantity, said = stated_quantity(options, "brdf", "BRDF")
    convention = options.convention or CONVENTIONS[0]
    # The file's frame has its +z at the back: seen from the front, azimuths run the other way.
    sign = -1.0 if side.side == "front" else 1.0
    turn = np.pi if convention == "phi_specular_0" else 0.0
    n, m = len(side.incident), len(side.outgoing)
    angles = {
        "theta_i": np.repeat(np.deg2rad(side.incident.theta), m),
        "phi_i": np.repeat(sign * np.deg2rad(side.incident.phi), m) + turn,
        "theta_o": np.tile(np.deg2rad(side.outgoing.theta), n),
        # The reader of angles turns the outgoing azimuth under phi_specular_0, which this undoes.
        "phi_o": np.tile(sign * np.deg2rad(side.outgoing.phi), n) - turn,
    }
    geometry = geo.from_angles(source, angles, convention)
    said += notes
    said.append(
        f"Values are averages over the patches of {side.incident.name} (incident) and {side.outgoing.name} "
        "(outgoing): directions are their centres."
    )
    if side.side == "front":
        said.append("The front: azimuths were mirrored, so that its normal is +z.")
    names = list(side.channels)
    channels = list(side.channels.values())
    if set(names) == set(_XYZ):
        names, channels = list(_XYZ), [Channel(c) for c in "XYZ"]
        said.append(TRISTIMULUS)
    provenance: dict[str, object] = {"side": side.side, "basis": [side.incident.name, side.outgoing.name]}
    for key in ("Manufacturer", "DeviceType"):
        if words := layer.words("Material", key):
            provenance[key] = words
    reading = Reading(
        NAME, quantity, np.stack([side.matrices[name].reshape(-1) for name in names], axis=1), channels,
        name=layer.words("Material", "Name"), item=item, notes=tuple(said), provenance=provenance,
    )  # fmt: skip
    return assemble(source, options, reading, geometry)
