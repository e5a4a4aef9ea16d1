"""LightTools BSDF text: blocks of one incidence, side and kind, on one grid of absolute scatter angles.

The plane of incidence is at azimuth 90 deg: the light of a block is at (AOI, 90 deg) and its mirror image at
270, as libbsdf (K. Ryo) reads these files. Only isotropic files (one POI) are read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fitter.formats import geometry as geo
from fitter.formats.assemble import TRISTIMULUS, Reading, assemble, stated_quantity
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.sniffing import found
from fitter.formats.source import Source
from fitter.formats.tokens import Tokens
from fitter.metadata import Channel
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "lighttools"
CONVENTIONS = ("phi_specular_180", "phi_specular_0")
_TRISTIMULUS = ("TrisX", "TrisY", "TrisZ")


def sniff(head: bytes, size: int) -> float:
    """Sure of a text with ScatterRadial and AOI lines (Zemax writes AngleOfIncidence)."""
    lines = [
        found(rb"(?:^|[\r\n])[ \t]*" + key + rb"[ \t]+[-+.\d]", head, key)
        for key in (b"ScatterRadial", b"AOI")
    ]
    return 0.98 if all(lines) else 0.0


@dataclass
class _Block:
    row: int
    numbers: dict[str, float] = field(default_factory=dict[str, float])
    words: dict[str, str] = field(default_factory=dict[str, str])
    values: FloatArray = field(default_factory=lambda: np.empty(0))


def read(source: Source, options: ReadOptions) -> list[Table]:
    """One table for each side that has reflection blocks; transmission blocks are counted and skipped."""
    tokens = Tokens(source, "#")
    words, azimuth, radial = _head(tokens)
    blocks: list[_Block] = []
    while tokens.peek() != "DataEnd":
        blocks.append(_block(tokens, len(azimuth) * len(radial)))
    kept = [b for b in blocks if b.words["ScatterType"] == "BRDF"]
    if not kept:
        raise source.no_table(
            "the file holds no reflection (BRDF) block", "table-transmission", "transmission",
            row=tokens.row, column="ScatterType", remedy="use the file of the same sample's reflection",
        )  # fmt: skip
    planes = {block.numbers.get("POI", 0.0) for block in kept}
    if len(planes) > 1:
        raise source.error(
            f"the file has blocks at {len(planes)} planes of incidence", "table-anisotropic", column="POI",
            cause="an anisotropic measurement, whose zero of azimuth the format does not define",
            remedy="write it as delimited text with phi_i and phi_o",
        )  # fmt: skip
    sides = [side for side in ("Front", "Back") if any(b.words["Side"] == side for b in kept)]
    notes = [f"{len(blocks) - len(kept)} transmission blocks: not read."] * (len(blocks) > len(kept))
    return [
        _table(
            source, options, [b for b in kept if b.words["Side"] == side], words, azimuth, radial,
            side.lower() if len(sides) > 1 else None, notes,
        )
        for side in sides
    ]  # fmt: skip


FORMAT = Format(NAME, "LightTools BSDF text", CONVENTIONS, sniff, read)


def _head(tokens: Tokens) -> tuple[dict[str, str], FloatArray, FloatArray]:
    words: dict[str, str] = {}
    lists: dict[str, FloatArray] = {}
    while (key := tokens.word("DataBegin")) != "DataBegin":
        if key == "Symmetry":
            words[key] = tokens.chosen(key, ("Asymmetric",))
        elif key == "SpectralContent":
            words[key] = tokens.chosen(key, ("Monochrome", "XYZ"))
        elif key in ("ScatterAzimuth", "ScatterRadial"):
            lists[key] = tokens.angles(key, 360.0 if key == "ScatterAzimuth" else 90.0)
        elif key[0].isalpha():
            # Source, names and the like: a word and its value.
            words[key] = tokens.word(key)
        else:
            raise tokens.error(
                f"{key[:40]!r} is no line of a header", "table-header",
                cause="a count that doesn't fit its list", remedy="correct the count",
            )  # fmt: skip
    missing = [k for k in ("SpectralContent", "ScatterAzimuth", "ScatterRadial") if k not in {*words, *lists}]
    if missing:
        raise tokens.error(
            f"the header has no {', '.join(missing)}", "table-header", cause="a damaged header",
            remedy="fetch the file again",
        )  # fmt: skip
    return words, lists["ScatterAzimuth"], lists["ScatterRadial"]


def _block(tokens: Tokens, count: int) -> _Block:
    tokens.peek()
    block = _Block(tokens.row)
    while (key := tokens.word("the next block")) != "TIS":
        if key in ("AOI", "POI", "Wavelength"):
            block.numbers[key] = float(tokens.numbers(1, key)[0])
        elif key in ("Side", "ScatterType", "TristimulusValue"):
            among = {"Side": ("Front", "Back"), "ScatterType": ("BRDF", "BTDF")}.get(key, _TRISTIMULUS)
            block.words[key] = tokens.chosen(key, among)
        else:
            raise tokens.error(
                f"{key[:40]!r} is no line of a block", "table-header",
                cause="the counts of the header don't fit",
                remedy="correct ScatterAzimuth or ScatterRadial, or fetch the file again",
            )  # fmt: skip
    aoi = block.numbers.get("AOI", np.nan)
    if not 0 <= aoi <= 90 or "Side" not in block.words or "ScatterType" not in block.words:
        raise tokens.error(
            "the block has no AOI from 0 to 90, Side and ScatterType", "table-header", column="AOI",
            remedy="write all three before TIS",
        )  # fmt: skip
    block.row = tokens.row
    tokens.numbers(1, "TIS")
    block.values = tokens.numbers(count, "BSDF values")
    return block


def _table(
    source: Source, options: ReadOptions, blocks: list[_Block], words: Mapping[str, str], azimuth: FloatArray,
    radial: FloatArray, item: str | None, notes: list[str],
) -> Table:  # fmt: skip
    xyz = words["SpectralContent"] == "XYZ"
    by_channel: dict[str | float, dict[float, FloatArray]] = {}
    for block in blocks:
        key = block.words.get("TristimulusValue", "") if xyz else block.numbers.get("Wavelength", 0.0)
        one = by_channel.setdefault(key, {})
        if block.numbers["AOI"] in one or key == "" or key != key:
            raise source.error(
                f"there are two blocks at AOI {block.numbers['AOI']:g}" if key else
                "the block does not say which tristimulus value it holds", "table-header", row=block.row,
                column="AOI", remedy="give each incidence and channel one block",
            )  # fmt: skip
        one[block.numbers["AOI"]] = block.values
    keys = sorted(by_channel, key=str) if xyz else sorted(by_channel)  # type: ignore[type-var]
    incidences = sorted(by_channel[keys[0]])
    if any(sorted(one) != incidences for one in by_channel.values()) or (xyz and len(keys) != 3):
        raise source.error(
            "the channels were not measured at the same incidences", "table-header", row=blocks[-1].row,
            column="AOI", cause="a block is missing", remedy="fetch the file again",
        )  # fmt: skip
    values = np.stack([np.concatenate([by_channel[k][i] for i in incidences]) for k in keys], axis=1)
    theta_i, phi_o, theta_o = (
        c.reshape(-1) for c in np.meshgrid(np.deg2rad(incidences), azimuth, radial, indexing="ij")
    )
    quarter = np.full_like(theta_i, np.pi / 2)
    angles = {"theta_i": theta_i, "phi_i": quarter, "theta_o": theta_o, "phi_o": phi_o}
    geometry = geo.from_angles(source, angles, options.convention)
    quantity, against = stated_quantity(options, "brdf", "BRDF")
    channels = (
        [Channel(str(k)[-1]) for k in keys] if xyz
        else [Channel(f"{k:g}nm" if len(keys) > 1 else "value", float(k) or None) for k in keys]
    )  # fmt: skip
    reading = Reading(
        NAME, quantity, values, channels, symmetry="isotropic", item=item, provenance=dict(words),
        angle_unit="deg",
        notes=(
            "The light of an isotropic LightTools file is at azimuth 90 deg.", *notes, *against,
            *([TRISTIMULUS] if xyz else []),
        ),
    )  # fmt: skip
    return assemble(source, options, reading, geometry, geo.find_grid(geometry))
