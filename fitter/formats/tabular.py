"""Tables of declared columns, whatever file they stand in: what the columns give, the tables in them."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from fitter.formats import geometry as geo
from fitter.formats.assemble import QUANTITY_REMEDY, Reading, assemble
from fitter.formats.columns import VOCABULARY, Column
from fitter.formats.read_options import ReadOptions
from fitter.formats.source import Source
from fitter.formats.tabular_header import Head, channels_of, declared_columns
from fitter.metadata import Channel, Quantity, Symmetry
from fitter.table import Table

FloatArray = NDArray[np.float64]

CONVENTIONS = ("phi_specular_180", "phi_specular_0", "forward", "back")
#: Element rc of a Mueller matrix, normalised or not: m12, f_r12, f_r12/f_r11.
_MUELLER = re.compile(r"(?:f_?r?_?|m_?|s_?)?[1-4][1-4](?:/.*)?", re.IGNORECASE)
#: Header lines that become fields of the table, and so are no provenance.
_FIELDS = frozenset({
    "quantity", "convention", "symmetry", "grid", "periodic", "channels", "rows", "name", "provenance",
    "scale_uncertainty", "aperture_deg", "aperture_rad", "angle_uncertainty_deg", "angle_uncertainty_rad",
})  # fmt: skip


class Rows(Protocol):
    """Named columns of a file, read when asked for. ``numbers`` are the rows' numbers for errors, from 1."""

    @property
    def names(self) -> Sequence[str]: ...

    @property
    def numbers(self) -> NDArray[np.intp] | range: ...

    def __len__(self) -> int: ...

    def floats(self, use: Sequence[int]) -> FloatArray:
        """The columns ``use`` as (n, len(use)); missing cells are NaN. TableError on what is no number."""
        ...

    def texts(self, column: int) -> list[str]:
        """One column as text."""
        ...


def read_columns(
    source: Source, options: ReadOptions, head: Head, rows: Rows, *, format: str, text: bool,
    group: str | None = None,
) -> list[Table]:  # fmt: skip
    """Tables of declared columns: one, or one for each wavelength or item where a column tells them apart.

    format : name of the format they stand in. text : whether that is text, which must end in a line end.
    group : what the columns are called where the file has several such tables: it begins the items' names.
    """
    columns = declared_columns(source, rows.names, options)
    # What is missing can be said before a million rows are read.
    system = _system(source, rows, columns)
    quantity, notes = _quantity(source, head, columns, options)
    used = [k for k in sorted(columns) if columns[k].kind != "item"]
    numbers = dict(zip(used, rows.floats(used).T, strict=True))
    ignored = [name for k, name in enumerate(rows.names) if k not in columns]
    mueller = [name for name in ignored if _MUELLER.fullmatch(name.strip())]
    if len(mueller) > 2:
        ignored = [name for name in ignored if name not in mueller]
        notes.append(
            f"{len(mueller)} Mueller elements ({mueller[0]} ... {mueller[-1]}) were not read: only "
            "unpolarised reflectance is."
        )
    if ignored:
        notes.append(f"Columns not used: {', '.join(ignored[:8])}{', ...' if len(ignored) > 8 else ''}.")
    parts = _items(rows, columns, numbers, group)
    source.release()  # the numbers are there: the bytes of a large file would only fill the memory
    taken = [
        _Part(item, nm, np.asarray(rows.numbers)[part], {k: column[part] for k, column in numbers.items()})
        for item, nm, part in parts
    ] or [_Part(group, None, rows.numbers, numbers)]
    if parts:
        numbers.clear()
    return [
        _table(source, options, head, rows, columns, part, system, quantity, notes, format=format, text=text)
        for part in taken
    ]  # fmt: skip


def _system(source: Source, rows: Rows, columns: Mapping[int, Column]) -> str:
    """Which description of the geometry the columns give: "vectors", "half_difference" or "angles"."""
    roles = {c.role for c in columns.values() if c.kind in ("angle", "component")}
    vectors = {f"{w}_{x}" for w in ("wi", "wo") for x in "xyz"}
    half = {"theta_h", "theta_d", "phi_d"}
    found = [
        name for name, group in (
            ("vectors", vectors), ("half_difference", half | {"phi_h"}),
            ("angles", {"theta_i", "theta_o", "phi_i", "phi_o", "dphi"}),
        ) if roles & group
    ]  # fmt: skip
    needed = {"vectors": vectors, "half_difference": half, "angles": {"theta_i", "theta_o"}}
    if len(found) > 1 or {"dphi", "phi_o"} <= roles:
        raise source.error(
            f"the columns describe the directions twice ({', '.join(sorted(roles))})", "table-columns",
            remedy="declare the ones not to be used as 'ignore'",
        )  # fmt: skip
    missing = sorted(needed[found[0]] - roles) if found else ["theta_i", "theta_o"]
    if missing:
        raise source.error(
            f"no column is declared as {', '.join(missing)}", "table-columns", parameter="columns",
            cause=f"the columns are called {', '.join(rows.names[:12])}",
            remedy=f"name the columns or give columns={{name or position: meaning}}; "
            f"meanings are {VOCABULARY}",
        )  # fmt: skip
    return found[0]


def _quantity(
    source: Source, head: Head, columns: Mapping[int, Column], options: ReadOptions
) -> tuple[Quantity, list[str]]:
    values = [c for c in columns.values() if c.kind == "value"]
    if not values:
        raise source.error(
            "no column is declared as a value", "table-columns", parameter="columns",
            remedy="call it brdf, ccbrdf, reflectance_factor or value (with _<channel>), or give columns=",
        )  # fmt: skip
    channels = [c.channel for c in values]
    sigmas = [c for c in columns.values() if c.kind == "sigma"]
    if sigmas and sorted(c.channel for c in sigmas) != sorted(channels):
        raise source.error(
            "sigma columns don't match the value columns", "table-columns", column="sigma",
            remedy="give one sigma_<channel> for each value column, or declare them as 'ignore'",
        )  # fmt: skip
    named: set[Quantity] = {c.quantity for c in [*values, *sigmas] if c.quantity}
    stated = cast("Quantity | None", head.stated.get("quantity"))
    chosen = options.quantity or stated
    if chosen is None and len(named) > 1:
        raise source.error(
            f"the columns hold several quantities ({', '.join(sorted(named))})", "table-quantity",
            parameter="quantity", remedy="declare the ones not to be used as 'ignore'",
        )  # fmt: skip
    chosen = chosen or (next(iter(named)) if named else None)
    if chosen is None:
        raise source.error(
            "the file does not say what its values are", "table-quantity", parameter="quantity",
            remedy=QUANTITY_REMEDY,
        )  # fmt: skip
    against = sorted((named | ({stated} if stated else set())) - {chosen})
    return chosen, [
        f"The file calls its values {', '.join(against)}; they were read as {chosen}."
    ] if against else []


def _items(
    rows: Rows, columns: Mapping[int, Column], numbers: Mapping[int, FloatArray], group: str | None
) -> list[tuple[str | None, float | None, NDArray[np.intp]]]:
    """(item, wavelength in nm, its rows) for each table the rows are divided into; empty when undivided."""
    before = f"{group} " if group else ""
    for k, column in columns.items():
        if column.kind == "wavelength":
            nm = numbers[k] * (1000.0 if column.unit == "um" else 1.0)
            nm = np.round(np.where(np.isfinite(nm) & (np.abs(nm) < 1e12), nm, np.nan), 6)
            distinct = np.unique(nm[np.isfinite(nm)])
            parts = [(f"{before}{w:.10g}nm", float(w), np.flatnonzero(nm == w)) for w in distinct]
            lost = np.flatnonzero(np.isnan(nm))
            return [*parts, *([(f"{before}unknown wavelength", None, lost)] if len(lost) else [])]
        if column.kind == "item":
            texts = np.asarray(rows.texts(k))
            return [
                (f"{before}{item}", None, np.flatnonzero(texts == item))
                for item in dict.fromkeys(texts.tolist())
            ]
    return []


@dataclass(frozen=True)
class _Part:
    """The rows of one table: what tells it apart, their numbers in the file, and column -> (n,)."""

    item: str | None
    wavelength_nm: float | None
    rows: NDArray[np.intp] | range
    columns: dict[int, FloatArray]


def _table(
    source: Source, options: ReadOptions, head: Head, rows: Rows, columns: Mapping[int, Column], part: _Part,
    system: str, quantity: Quantity, notes: list[str], *, format: str, text: bool,
) -> Table:  # fmt: skip
    """The table of ``part``, which is empty afterwards: a large one must not be in memory twice."""
    by_role = {c.role: k for k, c in columns.items() if c.kind in ("angle", "component")}
    convention = options.convention or head.stated.get("convention")
    if system != "angles":
        geo.refuse_convention(source, convention)
    values = [(k, c) for k, c in columns.items() if c.kind == "value"]
    sigmas = {c.channel: k for k, c in columns.items() if c.kind == "sigma"}
    channels = channels_of(source, head, [c.channel for _, c in values])
    if part.item is not None and part.wavelength_nm is not None and len(channels) == 1:
        channels = (Channel(f"{part.wavelength_nm:.10g}nm", part.wavelength_nm),)
    numbers = part.columns
    usable = next((numbers[k] > 0 for k, c in columns.items() if c.kind == "usable"), None)
    symmetry = cast("Symmetry | None", head.stated.get("symmetry"))
    reading = Reading(
        format, quantity, np.stack([numbers[k] for k, _ in values]).T, channels,
        sigma=np.stack([numbers[sigmas[c.channel]] for _, c in values]).T if sigmas else None,
        usable=usable, symmetry=symmetry, name=head.stated.get("name", ""), item=part.item,
        provenance=_provenance(head), statements=head.statements(), notes=(*head.notes, *notes), text=text,
        angle_unit=", ".join(sorted({columns[k].unit or "" for k in by_role.values()} - {""})),
    )  # fmt: skip
    given = {role: numbers[k] for role, k in by_role.items()}
    numbers.clear()
    names = {role: rows.names[k] for role, k in by_role.items()}
    if system == "vectors":
        wi, wo = (np.stack([given[f"{w}_{x}"] for x in "xyz"], axis=1) for w in ("wi", "wo"))
        geometry = geo.from_vectors(source, wi, wo, part.rows, (names["wi_x"], names["wo_x"]))
    else:
        units = {role: columns[k].unit or "" for role, k in by_role.items()}
        angles = geo.to_radians(source, given, units, names, part.rows)
        given.clear()
        geometry = (
            geo.from_half_difference(angles) if system == "half_difference"
            else geo.from_angles(source, angles, convention)
        )  # fmt: skip
        angles.clear()
    grid = _grid(source, head, geometry, symmetry)
    return assemble(source, options, reading, replace(geometry, coordinates={}), grid, copy=False)


def _grid(source: Source, head: Head, geometry: geo.Geometry, symmetry: Symmetry | None) -> Any:
    stated = head.stated.get("grid")
    if stated is None:
        found = geo.find_grid(geometry)
        # An isotropic grid can't hold the incident azimuth a table declared anisotropic depends on.
        return None if found and found[0].system != "spherical" and symmetry == "anisotropic" else found
    periodic: dict[str, float] | None = None
    if "periodic" in head.stated:
        try:
            periodic = {str(k): float(v) for k, v in json.loads(head.stated["periodic"]).items()}
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            raise source.error(
                "the header's periods can't be read", "table-header", row=head.rows_of["periodic"],
                parameter="periodic", remedy="mend or delete the line",
            ) from error  # fmt: skip
    found = geo.find_grid(geometry, system=stated, periodic=periodic, smallest=1)
    if found is None:
        raise source.error(
            f"the rows do not fill the {stated} grid the header states", "table-grid",
            row=head.rows_of["grid"], cause="rows are missing or repeated",
            remedy="fetch the file again, or delete the line '# grid:'",
        )  # fmt: skip
    return found


def _provenance(head: Head) -> dict[str, Any]:
    provenance: dict[str, Any] = {key: text for key, text in head.stated.items() if key not in _FIELDS}
    try:
        stored = json.loads(head.stated.get("provenance", "{}"))
    except (ValueError, RecursionError):
        stored = {"provenance": head.stated["provenance"]}
    if isinstance(stored, dict):
        provenance.update(cast("dict[str, Any]", stored))
    return provenance
