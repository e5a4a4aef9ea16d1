"""Zemax BSDF data interchange text: values on polar grids about the specular ray of each incidence."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.formats import geometry as geo
from fitter.formats import specular
from fitter.formats.assemble import ABOUT_SPECULAR, TRISTIMULUS, Reading, assemble, stated_quantity
from fitter.formats.fills import trailing_zeros
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.sniffing import found
from fitter.formats.source import Source
from fitter.formats.tokens import Tokens
from fitter.formats.zemax_writer import write_zemax
from fitter.metadata import Channel
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "zemax"
_WORDS = {
    "Source": ("Measured",),
    "Symmetry": ("PlaneSymmetrical", "ASymmetrical", "ASymmetrical4D"),
    "SpectralContent": ("Monochrome", "XYZ"),
    "ScatterType": ("BRDF", "BTDF"),
}
_LISTS = {"SampleRotation": 360.0, "AngleOfIncidence": 90.0, "ScatterAzimuth": 360.0, "ScatterRadial": 180.0}
_CONTENTS = ("Monochrome", "TristimulusX", "TristimulusY", "TristimulusZ")
_WAVELENGTH = re.compile(r"(?<![\w.])(\d{2,5}(?:\.\d+)?)\s*nm\b")


def sniff(head: bytes, size: int) -> float:
    """Sure of a text with the lines AngleOfIncidence and ScatterRadial; one is enough to be asked."""
    lines = [
        found(rb"(?:^|[\r\n])[ \t]*" + key + rb"[ \t]+\d", head, key)
        for key in (b"AngleOfIncidence", b"ScatterRadial")
    ]
    return (0.0, 0.6, 0.97)[sum(lines)]


@dataclass
class _Head:
    words: dict[str, str] = field(default_factory=dict[str, str])
    lists: dict[str, FloatArray] = field(default_factory=dict[str, FloatArray])


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The table of a Zemax file. Zeros that run to the end of a radial line are fill values: masked."""
    tokens = Tokens(source, "#")
    head = _head(tokens)
    quantity, notes = stated_quantity(options, "brdf", "BRDF")
    rotation, incidence, azimuth, radial = (head.lists[key] for key in _LISTS)
    shape = (len(rotation), len(incidence), len(azimuth), len(radial))
    blocks: dict[str, FloatArray] = {}
    tis: dict[str, list[float]] = {}
    wanted = ("Monochrome",) if head.words["SpectralContent"] == "Monochrome" else _CONTENTS[1:]
    for content in wanted:
        if tokens.word("the spectral content").lower() != content.lower():
            raise tokens.error(
                f"a block {content} should begin here", "table-header", column="SpectralContent",
                remedy=f"the blocks of this file are {', '.join(wanted)}",
            )  # fmt: skip
        tokens.chosen("DataBegin", ("DataBegin",))
        blocks[content], tis[content] = _block(tokens, shape)
        tokens.chosen("DataEnd", ("DataEnd",))
    if tokens.left:
        tokens.word("nothing")
        raise tokens.error(
            "the file goes on after its last block", "table-header",
            cause="the counts of the header don't fit", remedy="correct the counts, or fetch the file again",
        )  # fmt: skip
    values = np.stack(list(blocks.values()), axis=-1)
    notes += _notes(head, tokens)
    # A sample turned by r under a fixed light sees the light turned by -r.
    r, i, a, s = (c.reshape(-1) for c in np.meshgrid(rotation, incidence, azimuth, radial, indexing="ij"))
    geometry = geo.from_directions(
        directions.vector_from_spherical(i, -r), specular.outgoing(i, -r, s, a), "about the specular ray",
        symmetric=len(rotation) == 1,
    )  # fmt: skip
    if len(wanted) == 3:
        channels = [Channel(name[-1]) for name in wanted]
        notes.append(TRISTIMULUS)
    else:
        nm = {float(match) for line in tokens.comments for match in _WAVELENGTH.findall(line)}
        wavelength = nm.pop() if len(nm) == 1 else None
        channels = [Channel("value", wavelength)]
        if wavelength is not None:
            notes.append(f"The wavelength, {wavelength:g} nm, is from the comments.")
    reading = Reading(
        NAME, quantity, values.reshape(-1, len(wanted)), channels, angle_unit="deg",
        filled=trailing_zeros(values, -2).reshape(-1),
        symmetry="isotropic" if len(rotation) == 1 else "anisotropic",
        provenance={**head.words, "comments": [c for c in tokens.comments if c.strip("=- ")], "TIS": tis},
        notes=tuple(notes),
    )  # fmt: skip
    return [assemble(source, options, reading, geometry)]


FORMAT = Format(
    NAME, "Zemax BSDF interchange text, polar about the specular ray", (), sniff, read, write=write_zemax
)


def _head(tokens: Tokens) -> _Head:
    head = _Head()
    while tokens.peek() not in _CONTENTS:
        key = tokens.word("DataBegin")
        if key in _WORDS:
            head.words[key] = tokens.chosen(key, _WORDS[key])
            if head.words[key] == "BTDF":
                raise tokens.source.no_table(
                    "the file holds transmission (BTDF)", "table-transmission", "transmission",
                    row=tokens.row, column=key, remedy="use the file of the same sample's reflection (BRDF)",
                )  # fmt: skip
        elif key in _LISTS:
            head.lists[key] = tokens.angles(key, _LISTS[key])
            last = float(np.rad2deg(head.lists[key][-1]))
            if key == "ScatterAzimuth" and min(abs(last - turn) for turn in (np.pi, 2 * np.pi)) < 1e-3:
                raise tokens.error(
                    f"the scatter azimuths end at {last:g} deg", "table-angle-unit", column=key,
                    cause="the angles are in radians", remedy="write them in degrees",
                )  # fmt: skip
        else:
            raise tokens.error(
                f"{key[:40]!r} is no line of a Zemax header", "table-header", cause="a damaged header",
                remedy=f"the lines are {', '.join([*_WORDS, *_LISTS])}",
            )  # fmt: skip
    missing = [key for key in [*_WORDS, *_LISTS] if key not in head.words and key not in head.lists]
    if missing and missing != ["Source"]:
        raise tokens.error(
            f"the header has no {', '.join(missing)}", "table-header", cause="a damaged header",
            remedy="fetch the file again",
        )  # fmt: skip
    return head


def _block(tokens: Tokens, shape: tuple[int, int, int, int]) -> tuple[FloatArray, list[float]]:
    """Values (rotations, incidences, azimuths, radials) of one block, and its TIS figures."""
    parts: list[FloatArray] = []
    tis: list[float] = []
    for _ in range(shape[0]):
        for _ in range(shape[1]):
            tokens.chosen("TIS", ("TIS",))
            tis.append(float(np.nan_to_num(tokens.numbers(1, "TIS")[0], nan=-1.0, posinf=-1.0, neginf=-1.0)))
            parts.append(tokens.numbers(shape[2] * shape[3], "BSDF values"))
    return np.concatenate(parts).reshape(shape), tis


def _notes(head: _Head, tokens: Tokens) -> list[str]:
    notes = [ABOUT_SPECULAR]
    if len(head.lists["ScatterAzimuth"]) > 1 and head.lists["ScatterRadial"][0] == 0:
        notes.append(
            "Radial 0 is the specular ray itself, given once for each azimuth: the rest count as repeated."
        )
    if head.words["Symmetry"] == "PlaneSymmetrical":
        notes.append("The file states symmetry about the plane of incidence; only its half is in the table.")
    if len(head.lists["SampleRotation"]) > 1:
        notes.append("A sample rotation r was read as an incident azimuth of -r.")
    return notes
