"""WINDOW's BSDF XML: layers, and the reflection blocks in them by side and wavelength.

Layout and directions are those that Radiance writes and reads (genBSDF, bsdf2klems, bsdf2ttree). Both sides
share one frame, whose +z is the *back* (the room).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar, cast

from fitter.formats.assemble import TRISTIMULUS
from fitter.formats.columns import band_nm
from fitter.formats.source import Source
from fitter.formats.text import number
from fitter.formats.xml_tree import Element, parse_xml
from fitter.metadata import Channel

Side = Literal["front", "back"]
Read = TypeVar("Read")

_ROOT = re.compile(rb"<(?:\w+:)?WindowElement[\s>]")
_DIRECTION = re.compile(r"(reflection|transmission) (front|back)")
_UNITS = {"nanometer": 1.0, "nm": 1.0, "micron": 1000.0, "micrometer": 1000.0, "um": 1000.0}
#: Wavelength words of the three files' parts that together are CIE X, Y and Z.
_XYZ = ("CIE-X", "Visible", "CIE-Z")
#: Chromaticities that go with a luminance: no reflectance of their own.
_CHROMATICITY = ("CIE-u", "CIE-v")
#: The note of a front.
MIRRORED = "The front: azimuths were mirrored, so that its normal is +z."


@dataclass(frozen=True)
class Block:
    """One WavelengthDataBlock of reflection."""

    element: Element
    side: Side
    channel: Channel


@dataclass(frozen=True)
class Layer:
    """One optical layer. ``number`` counts from 1; ``structure`` is its IncidentDataStructure."""

    element: Element
    number: int
    structure: str
    blocks: tuple[Block, ...]


def is_window(head: bytes) -> bool:
    """Whether the first bytes are those of an XML text whose root is a WindowElement."""
    return head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<") and _ROOT.search(head) is not None


def layers_of(source: Source) -> tuple[list[Layer], list[str]]:
    """The layers and notes of what was skipped. Raises TableError where nothing reflects."""
    root = parse_xml(source)
    elements = [layer for optical in root.all("Optical") for layer in optical.all("Layer")]
    if root.name.lower() != "windowelement" or not elements:
        raise source.error(
            "the XML is no WindowElement with an optical layer", "table-header", row=root.row,
            cause="XML of another kind, or a damaged file", remedy="use a BSDF file of WINDOW or Radiance",
        )  # fmt: skip
    layers: list[Layer] = []
    transmission = 0
    notes: list[str] = []
    for place, element in enumerate(elements, start=1):
        blocks, skipped, chromaticity = _blocks(source, element)
        structure = element.words("DataDefinition", "IncidentDataStructure")
        layers.append(Layer(element, place, structure, tuple(blocks)))
        transmission += skipped
        if chromaticity:
            notes.append(f"{chromaticity} blocks hold chromaticities ({', '.join(_CHROMATICITY)}): not read.")
    if not any(layer.blocks for layer in layers):
        remedy = "use a file that has Reflection Front or Reflection Back blocks"
        if transmission:
            raise source.no_table(
                f"the file holds transmission only ({transmission} blocks)", "table-transmission",
                "transmission", column="WavelengthDataDirection", remedy=remedy,
            )  # fmt: skip
        raise source.error(
            "the file holds no scattering data", "table-empty", row=root.row, remedy=remedy
        )
    if transmission:
        notes.insert(0, f"{transmission} transmission blocks are in the file: not read.")
    return layers, notes


def by_side(
    source: Source, layers: Iterable[Layer], read: Callable[[Layer, Block], Read]
) -> list[tuple[Layer, Side, dict[Channel, Read]]]:
    """What ``read`` makes of each block, for each layer and side that reflects, by channel."""
    found: list[tuple[Layer, Side, dict[Channel, Read]]] = []
    for layer in layers:
        sides: dict[Side, dict[Channel, Read]] = {}
        for block in layer.blocks:
            entry = sides.setdefault(block.side, {})
            if any(channel.name == block.channel.name for channel in entry):
                raise source.error(
                    f"the {block.side} reflection is given twice for {block.channel.name[:40]}",
                    "table-header", row=block.element.row, column="Wavelength",
                    remedy="keep one block for each wavelength and direction",
                )  # fmt: skip
            entry[block.channel] = read(layer, block)
        found.extend((layer, side, entry) for side, entry in sides.items())
    return found


def item_of(layer: Layer, side: Side, sides: Sequence[tuple[Layer, Side, object]]) -> str | None:
    """What tells a side's table from the file's others, None where there is only one."""
    if len(sides) == 1:
        return None
    return f"layer {layer.number} {side}" if len({one.number for one, _, _ in sides}) > 1 else side


def in_order(found: Mapping[Channel, Read]) -> tuple[list[Channel], list[Read], list[str]]:
    """The channels, what was read of each, and notes: X, Y and Z by these names where all are there."""
    by_name = {channel.name: one for channel, one in found.items()}
    if set(by_name) == set(_XYZ):
        return [Channel(c) for c in "XYZ"], [by_name[name] for name in _XYZ], [TRISTIMULUS]
    return list(found), list(found.values()), []


def provenance_of(layer: Layer, side: Side) -> dict[str, object]:
    """What the file says of the sample."""
    said: dict[str, object] = {"side": side}
    for key in ("Manufacturer", "DeviceType"):
        if words := layer.element.words("Material", key):
            said[key] = words
    return said


def _blocks(source: Source, layer: Element) -> tuple[list[Block], int, int]:
    """The reflection blocks of a layer, and how many transmission and chromaticity blocks it has."""
    blocks: list[Block] = []
    transmission = chromaticity = 0
    for data in layer.all("WavelengthData"):
        channel = _channel(data)
        for element in data.all("WavelengthDataBlock"):
            words = element.words("WavelengthDataDirection")
            match = _DIRECTION.fullmatch(" ".join(words.lower().split()))
            if match is None:
                raise source.error(
                    f"WavelengthDataDirection is {words[:40]!r}", "table-header", row=element.row,
                    column="WavelengthDataDirection", cause="a damaged header",
                    remedy="write Reflection or Transmission, then Front or Back",
                )  # fmt: skip
            if match[1] == "transmission":
                transmission += 1
            elif channel.name in _CHROMATICITY:
                chromaticity += 1
            else:
                blocks.append(Block(element, cast("Side", match[2]), channel))
    return blocks, transmission, chromaticity


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
