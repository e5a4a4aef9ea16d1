"""HDF5 and NetCDF-4: datasets are the columns of delimited text, attributes its header lines.

Dimension scales say which axes belong together. Without them an axis is matched by its label
(DIMENSION_LABELS, or the attribute ``axes`` of NeXus) or by its length, where only one fits. Every group with
values is a table; axes may stand in the groups above it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.formats.arrays import Variable, shaping, tables_of
from fitter.formats.columns import Column, parse_column
from fitter.formats.hdf5_file import STRUCTURE, Dataset, Group, groups_of, unread
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.source import Source
from fitter.formats.tabular import CONVENTIONS
from fitter.table import Table

NAME = "hdf5"
MAGIC = b"\x89HDF\r\n\x1a\n"
#: An axis that nothing says the meaning of.
_UNNAMED = "unnamed"


def sniff(head: bytes, size: int) -> float:
    """Sure by the first eight bytes."""
    return 1.0 if head.startswith(MAGIC) else 0.0


def read(source: Source, options: ReadOptions) -> list[Table]:
    """A table for each group that holds values, and each wavelength or item in it."""
    groups = groups_of(source)
    holding = [group for group in groups if _has_values(group, options)]
    if not holding:
        holding = [_only_group(source, groups, options)]
    tables: list[Table] = []
    for group in holding:
        above = [one for one in groups if group.path.startswith(f"{one.path}/") or one is group]
        variables = _variables(source, group, above, options)
        said = {key: words for one in above for key, words in _statements(one.attributes).items()}
        label = (group.path.strip("/") or "root") if len(holding) > 1 else None
        tables += tables_of(source, options, variables, said, format=NAME, group=label)
    return tables


FORMAT = Format(
    NAME, "HDF5 and NetCDF-4, datasets named as in delimited text", CONVENTIONS, sniff, read
)  # fmt: skip


def _meaning(name: str, options: ReadOptions) -> Column | None:
    """What a dataset is declared as, by ``columns=`` or by its own name."""
    return parse_column(dict(options.columns).get(name, name))


def _has_values(group: Group, options: ReadOptions) -> bool:
    """Whether the group itself holds a value column. A position in ``columns=`` can't tell between groups."""
    names = [*(name for one in group.datasets for name in _column_names(one)), *group.unread]
    return any(column.kind == "value" for name in names if (column := _meaning(name, options)))


def _only_group(source: Source, groups: Sequence[Group], options: ReadOptions) -> Group:
    """The one group that holds anything: what it lacks is said where its columns are read."""
    filled = [group for group in groups if group.datasets or group.unread]
    if len(filled) == 1:
        return filled[0]
    names = [f"{group.path or '/'}: {', '.join(one.name for one in group.datasets)}" for group in filled]
    raise source.error(
        f"no group of the file holds values ({'; '.join(names)[:300]})" if filled
        else "the file holds no datasets", "table-columns" if filled else "table-empty",
        parameter="columns" if filled else None,
        remedy="call a dataset brdf, ccbrdf, reflectance_factor or value, or give columns={name: meaning}"
        if filled else "check that it is whole",
    )  # fmt: skip


def _column_names(one: Dataset) -> list[str]:
    """The columns a dataset gives: itself, or each field of its records."""
    if one.kind == "record":
        return list(np.dtype(one.stored.known.dtype).names or ())
    return [one.name]


def _variables(
    source: Source, group: Group, above: Sequence[Group], options: ReadOptions
) -> list[Variable]:
    """The group's own datasets, and the geometry of the groups above that it has none of its own of."""
    for name, reason in group.unread.items():
        if _meaning(name, options) is not None:
            raise unread(source, reason, name)
    own = [one for one in group.datasets if not one.is_bare_dimension and one.kind != "other"]
    roles = {column.role for one in own for column in [_meaning(one.name, options)] if column}
    inherited: list[Dataset] = []
    for parent in reversed([one for one in above if one is not group]):
        for one in parent.datasets:
            column = _meaning(one.name, options)
            geometric = column is not None and column.kind in ("angle", "component", "wavelength")
            if column is None or not geometric or column.role in roles or one.kind != "number":
                continue
            roles.add(column.role)
            inherited.append(one)
    datasets = [*own, *inherited]
    axes = _axes(datasets, group, options)
    variables: list[Variable] = []
    for one, names in zip(datasets, axes, strict=True):
        if one.kind == "record":
            variables += [_field(one, field, names) for field in _column_names(one)]
        else:
            text = one.kind == "text"
            variables.append(Variable(one.name, names, one.shape, one.attributes, one.read, text))
    # Files list datasets by name, unless told otherwise when they were written: B, G, R.
    return sorted(variables, key=lambda one: _colour(_meaning(one.name, options)))


def _colour(column: Column | None) -> int:
    return "RGB".find(column.channel) if column is not None and len(column.channel) == 1 else -1


def _field(one: Dataset, field: str, names: tuple[str, ...]) -> Variable:
    """One field of the records of a dataset."""

    def numbers() -> NDArray[Any]:
        return np.asarray(one.read()[field])

    number = np.dtype(one.stored.known.dtype)[field].kind in "iuf"
    return Variable(field, names, one.shape, one.attributes, numbers, text=not number)


def _axes(datasets: Sequence[Dataset], group: Group, options: ReadOptions) -> list[tuple[str, ...]]:
    """A name for every axis of every dataset: its scale's, its label's, or that of the one axis as long."""
    numeric = [one for one in datasets if one.kind in ("number", "record")]
    at = shaping([(one.name, one.shape) for one in numeric], options)
    if at is None:
        return [tuple(_UNNAMED for _ in one.shape) for one in datasets]
    largest = numeric[at]
    labels = _labels(largest, group)
    whole = tuple(
        scale or label or f"axis {k}"
        for k, (scale, label) in enumerate(zip(largest.scales, labels, strict=True))
    )
    return [whole if one is largest else _matched(one, largest, whole, labels) for one in datasets]


def _matched(
    one: Dataset, largest: Dataset, whole: tuple[str, ...], labels: Sequence[str | None]
) -> tuple[str, ...]:
    """Names of a dataset's axes, those of the largest one's where they are the same."""
    loose = all(name is None or name == one.path for name in one.scales)
    if loose and one.shape == largest.shape and not (one.is_scale and any(largest.scales)):
        return whole
    if len(one.shape) == 1 and loose:
        named = [
            name for name, label, n in zip(whole, labels, largest.shape, strict=True)
            if label == one.name and n == one.shape[0]
        ]  # fmt: skip
        if len(named) == 1:
            return (named[0],)
    names: list[str] = []
    for scale, n in zip(one.scales, one.shape, strict=True):
        if scale is not None and (scale != one.path or scale in whole):
            names.append(scale)
            continue
        # Of axes that have scales of their own, none is this one.
        fitting = [
            name for name, size, taken in zip(whole, largest.shape, largest.scales, strict=True)
            if size == n and taken is None and name not in one.scales
        ]  # fmt: skip
        names.append(fitting[0] if len(fitting) == 1 else scale or _UNNAMED)
    return tuple(names)


def _labels(largest: Dataset, group: Group) -> list[str | None]:
    """What the file calls the axes of its largest dataset, None where it says nothing."""
    rank = len(largest.shape)
    for said in (
        largest.attributes.get("DIMENSION_LABELS"), largest.attributes.get("axes"),
        group.attributes.get("axes"),
    ):  # fmt: skip
        words = said.split(":") if isinstance(said, str) else said
        if isinstance(words, list) and len(words) == rank:
            return [str(word).strip() or None for word in words]
    return [None] * rank


def _statements(attributes: Mapping[str, Any]) -> dict[str, str]:
    """A group's attributes as header lines."""
    said: dict[str, str] = {}
    for key, value in attributes.items():
        if key in STRUCTURE or value is None:
            continue
        if isinstance(value, np.ndarray | np.generic):
            if value.dtype.kind not in "iufbSU" or value.size > 100:
                continue
            value = value.item() if value.size == 1 else value.tolist()
        elif not isinstance(value, str | list):
            continue
        said[key] = str(value)
    return said
