"""pab-opto goniophotometer text, as Radiance's pabopto2bsdf reads it: one file for each incidence.

Header lines begin with '#'; rows are theta, phi and one value, or three for CIE-XYZ. Both directions use one
frame: theta = 180 deg is the normal of the back (Radiance manual, pabopto2bsdf.1).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter.formats import geometry as geo
from fitter.formats.assemble import TRISTIMULUS, Reading, assemble, of_several, stated_quantity
from fitter.formats.output import measured, one_line, one_or_tristimulus, unwritable, write_aside
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format, Loss
from fitter.formats.sniffing import found
from fitter.formats.source import Source
from fitter.formats.text import Rows
from fitter.metadata import Channel, Quantity
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "pab-opto"
CONVENTIONS = ("phi_specular_180", "phi_specular_0")
_QUANTITIES: dict[str, Quantity] = {"bsdf": "brdf", "brdf": "brdf", "btdf": "brdf", "dsf": "ccbrdf"}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_FORMAT = rb"(?:^|[\r\n])#[ \t]*format:[ \t]*theta[ \t]+phi[ \t]"
_INCIDENCE = rb"(?:^|[\r\n])#[ \t]*(?:intheta|incident_angle)[ \t:]"


def sniff(head: bytes, size: int) -> float:
    """Sure of a text with both a #format: theta phi line and an incidence; one is enough to be asked."""
    stated = found(_FORMAT, head, b"format:", folded=True)
    return (0.0, 0.6, 0.96)[stated + found(_INCIDENCE, head, b"intheta", b"incident_angle", folded=True)]


@dataclass(frozen=True)
class _Part:
    """One file: its geometry by angle (radians), its values, and what it says."""

    source: Source
    name: str
    side: str
    quantity: Quantity
    angles: dict[str, FloatArray]
    values: FloatArray
    skipped: int
    upphi: float
    keys: dict[str, str]


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The table of one incidence."""
    return together([source], options)


def together(sources: Sequence[Source], options: ReadOptions) -> list[Table]:
    """One table for all incidences of a sample's side. Rows on the other side are transmission: skipped."""
    parts = [_part(source) for source in sources]
    groups: dict[tuple[str, str], list[_Part]] = {}
    for part in parts:
        if len(part.values):
            groups.setdefault((part.name, part.side), []).append(part)
    if not groups:
        raise sources[0].no_table(
            "all rows are on the side away from the light: transmission", "table-transmission",
            "transmission", remedy="use the files of the same sample's reflection",
        )  # fmt: skip
    sides = {side for _, side in groups}
    return [_table(group, options, side if len(sides) > 1 else None) for (_, side), group in groups.items()]


def write(table: Table, path: Path) -> list[Loss]:
    """Write a folder with one file for each incidence: angles in degrees with full digits, values as BSDF."""
    xyz = one_or_tristimulus(table, NAME)
    path.mkdir(parents=True, exist_ok=True)
    if any(path.iterdir()):
        raise unwritable(table, f"the folder {path.name} is not empty", "name a new or empty folder")
    samples, losses = measured(table)
    keys = np.round(np.stack([samples.theta_i, samples.phi_i], axis=1), 9)
    incidences, owner = np.unique(keys, axis=0, return_inverse=True)
    for k in range(len(incidences)):
        here = np.flatnonzero(owner.reshape(-1) == k)
        head = [
            "#comment f_r in 1/sr, without the cosine; angles in degrees",
            f'#sample_name "{one_line(table.metadata.name).replace(chr(34), chr(39))}"',
            f"#intheta {float(np.rad2deg(samples.theta_i[here[0]]))!r}",
            f"#inphi {float(np.rad2deg(samples.phi_i[here[0]]))!r}",
            "#upphi 0", f"#colorimetry: CIE-{'XYZ' if xyz else 'Y'}", f"#datapoints_in_file: {len(here)}",
            "#format: theta phi BSDF",
        ]  # fmt: skip
        columns = [np.rad2deg(samples.theta_o[here]), np.rad2deg(samples.phi_o[here]), *samples.value[here].T]
        rows = zip(*(column.tolist() for column in columns), strict=True)
        lines = chain(head, (" ".join(map(repr, row)) for row in rows))
        write_aside(path / f"incidence_{k + 1:04d}.txt", (f"{line}\n".encode() for line in lines))
    return losses


FORMAT = Format(
    NAME, "pab-opto goniophotometer text, one file an incidence", CONVENTIONS, sniff, read, together, write
)


def _part(source: Source) -> _Part:
    keys, rows_of, body = _keys(source)
    stated = re.fullmatch(r"theta\s+phi\s+(\w+)", keys.get("format", ""), re.IGNORECASE)
    if stated is None or stated[1].lower() not in _QUANTITIES:
        raise source.error(
            f"#format is {keys.get('format', '(not given)')[:40]!r}", "table-quantity",
            row=rows_of.get("format"), column="format", remedy='write "#format: theta phi BSDF" or DSF',
        )  # fmt: skip
    theta_i, phi_i = _incidence(source, keys, rows_of)
    (upphi,) = _floats(source, keys, rows_of, "upphi", 1) or (0.0,)
    colours = keys.get("colorimetry", "CIE-Y").upper()
    if colours not in ("CIE-Y", "CIE-XYZ"):
        raise source.error(
            f"#colorimetry is {colours[:40]!r}", "table-header", row=rows_of["colorimetry"],
            column="colorimetry", remedy="write CIE-Y or CIE-XYZ",
        )  # fmt: skip
    channels = 3 if colours == "CIE-XYZ" else 1
    lines = [(n, line) for n, line in enumerate(source.lines[body:], start=body + 1) if line.strip()]
    numbers = np.asarray([n for n, _ in lines], np.intp)
    names = ["theta", "phi", *(["value"] if channels == 1 else "XYZ")]
    promised = _floats(source, keys, rows_of, "datapoints_in_file", 1)
    rows = Rows(source, [line for _, line in lines], numbers, None, names)
    table = rows.floats(range(len(names))) if lines else np.empty((0, len(names)))
    if not lines or (promised is not None and promised[0] != len(lines)):
        raise source.error(
            f"the file has {len(lines)} rows" + (f" and states {promised[0]:g}" if promised else ""),
            "table-truncated", row=int(numbers[-1]) if lines else len(source.lines),
            cause="the file is cut off", remedy="fetch the file again, or correct #datapoints_in_file",
        )  # fmt: skip
    given = {"theta_i": np.full(len(lines), theta_i), "phi_i": np.full(len(lines), phi_i)}
    given |= {"theta_o": table[:, 0], "phi_o": table[:, 1]}
    labels = {"theta_i": "intheta", "phi_i": "inphi", "theta_o": "theta", "phi_o": "phi"}
    angles = geo.to_radians(source, given, dict.fromkeys(given, "deg"), labels, numbers)
    back = theta_i > 90
    turned = {role: angle - (np.deg2rad(upphi) if "phi" in role else 0.0) for role, angle in angles.items()}
    if back:
        # The back is read as a front: mirrored, so that azimuths run the other way.
        turned = {role: -a if "phi" in role else np.pi - a for role, a in turned.items()}
    kept = ~(turned["theta_o"] > np.pi / 2 + geo.HORIZON)
    return _Part(
        source, keys.get("sample_name", "").strip('"'), "back" if back else "front",
        _QUANTITIES[stated[1].lower()], {role: a[kept] for role, a in turned.items()}, table[kept, 2:],
        int(np.count_nonzero(~kept)), upphi, keys,
    )  # fmt: skip


def _keys(source: Source) -> tuple[dict[str, str], dict[str, int], int]:
    """Header keys (lower case), their rows, and how many lines the header has."""
    keys: dict[str, str] = {}
    rows_of: dict[str, int] = {}
    for number, line in enumerate(source.lines, start=1):
        bare = line.strip()
        if bare and not bare.startswith("#"):
            return keys, rows_of, number - 1
        match = re.fullmatch(r"#+\s*(\w+)\s*:?\s*(.*)", bare)
        if match:
            keys[match[1].lower()], rows_of[match[1].lower()] = match[2].strip(), number
    return keys, rows_of, len(source.lines)


def _incidence(source: Source, keys: dict[str, str], rows_of: dict[str, int]) -> tuple[float, float]:
    both = _floats(source, keys, rows_of, "incident_angle", 2)
    theta = _floats(source, keys, rows_of, "intheta", 1) or (both[:1] if both else None)
    phi = _floats(source, keys, rows_of, "inphi", 1) or (both[1:] if both else None)
    if theta is None or phi is None or not 0 <= theta[0] <= 180 or abs(phi[0]) > 720:
        raise source.error(
            "the header does not say where the light is" if theta is None or phi is None
            else f"the light is at theta {theta[0]:g}, phi {phi[0]:g} deg",
            "table-header", row=rows_of.get("intheta", rows_of.get("incident_angle", 1)), column="intheta",
            remedy='write "#intheta" (0 to 180) and "#inphi", in degrees',
        )  # fmt: skip
    return theta[0], phi[0]


def _floats(
    source: Source, keys: dict[str, str], rows_of: dict[str, int], key: str, count: int
) -> tuple[float, ...] | None:
    if key not in keys:
        return None
    words = keys[key].split()[:count]
    if len(words) < count or not all(re.fullmatch(_NUMBER, word) for word in words):
        raise source.error(
            f"#{key} is {keys[key][:40]!r}", "table-header", row=rows_of[key], column=key,
            cause="a damaged header", remedy=f"write {count} number{'s' if count > 1 else ''}",
        )  # fmt: skip
    return tuple(float(word) for word in words)


def _table(group: Sequence[_Part], options: ReadOptions, item: str | None) -> Table:
    first = group[0]
    for part in group:
        if part.values.shape[1] != first.values.shape[1] or part.quantity != first.quantity:
            raise part.source.error(
                f"its rows hold another quantity or colorimetry than those of {first.source.name}",
                "table-quantity", column="format", remedy="keep files of one kind in a folder",
            )  # fmt: skip
    angles = {role: np.concatenate([part.angles[role] for part in group]) for role in first.angles}
    geometry = geo.from_angles(first.source, angles, options.convention)
    words = "DSF" if first.quantity == "ccbrdf" else "BSDF"
    quantity, notes = stated_quantity(options, first.quantity, words)
    skipped = sum(part.skipped for part in group)
    if skipped:
        notes.append(f"{skipped} rows are on the other side (transmission): not read.")
    if first.side == "back":
        notes.append("The back of the sample: angles were mirrored, so that its normal is +z.")
    if any(part.upphi for part in group):
        notes.append("Azimuths count from #upphi.")
    xyz = first.values.shape[1] == 3
    channels = [Channel(c) for c in "XYZ"] if xyz else [Channel("Y")]
    notes.append(TRISTIMULUS if xyz else "The channel is photometric (CIE Y).")
    reading = Reading(
        NAME, quantity, np.concatenate([part.values for part in group]), channels, name=first.name,
        item=item, provenance=dict(first.keys) if len(group) == 1 else {}, notes=tuple(notes),
        angle_unit="deg",
    )  # fmt: skip
    table = assemble(first.source, options, reading, geometry, geo.find_grid(geometry))
    if len(group) == 1:
        return table
    return of_several(table, [part.source for part in group], table.metadata.name)
