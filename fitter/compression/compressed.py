"""CompressedTable: a table made smaller with a guaranteed error bound on every measured value."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from os import PathLike
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter.compression import container
from fitter.compression.container import Block
from fitter.compression.prediction import decode, encode
from fitter.compression.quantise import (
    SMALLEST_TOLERANCE,
    dequantise,
    error_in_bounds,
    quantise,
)
from fitter.errors import SpecError, TableError
from fitter.table import Channel, Grid, Metadata, Table

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class CompressedTable:
    """A table in its packed form.

    header : JSON-ready description: tolerance, floors, geometry, channels, metadata, hash of the original.
    blocks : the packed arrays by name.
    """

    header: Mapping[str, Any]
    blocks: Mapping[str, Block]

    @property
    def tolerance(self) -> float:
        """The guarantee: |error| <= tolerance (|f| + floor) for every finite value; 0 means lossless."""
        return float(self.header["tolerance"])

    @property
    def floor(self) -> FloatArray:
        """(C,) the floors of the guarantee, 1/sr."""
        return np.array(self.header["floor"], np.float64)

    @property
    def worst_error(self) -> float:
        """Largest error made, in units of the guarantee (<= 1), checked when the table was compressed."""
        return float(self.header["worst_error"])

    @property
    def source_hash(self) -> str:
        """``Table.hash`` of the table that was compressed."""
        return str(self.header["source_hash"])

    @property
    def nbytes(self) -> int:
        """Size of the container in bytes."""
        return len(container.encode_header(self.header, self.blocks)) + sum(
            len(block.data) for block in self.blocks.values()
        )

    @property
    def ratio(self) -> float:
        """Bytes of the values as float64, over :attr:`nbytes` (which includes directions, sigma and mask)."""
        return 8.0 * self.header["samples"] * len(self.header["channels"]) / self.nbytes

    def save(self, path: str | PathLike[str]) -> None:
        """Write the container; written aside and renamed, so that it is never half there."""
        container.write(self.header, self.blocks, Path(path))

    @classmethod
    def load(cls, path: str | PathLike[str]) -> CompressedTable:
        """Read a container. Raises TableError naming the damaged block, or OSError."""
        path = Path(path)
        return cls.from_bytes(path.read_bytes(), file=path.name)

    @classmethod
    def from_bytes(cls, data: bytes, file: str | None = None) -> CompressedTable:
        """The container in ``data``; ``file`` only names it in errors."""
        header, blocks = container.read(data, file)
        return cls(header, blocks)

    def decompress(self) -> Table:
        """The table again: masks, sigma, channels, geometry and metadata exactly, values within the bound.

        Raises
        ------
        TableError : a block that can't be unpacked, or a lossless table whose hash is not the original's.
        """
        samples = int(self.header["samples"])
        value = np.empty((samples, len(self.header["channels"])))
        for k in range(value.shape[1]):
            value[:, k] = self._channel(k)
        wi, wo = (self._array(name) if name in self.blocks else None for name in ("wi", "wo"))
        document: dict[str, Any] = dict(self.header["metadata"])
        document["notes"] = tuple(document["notes"])
        metadata = Metadata(**document)
        table = Table(
            value=value, grid=self._grid(), wi=wi, wo=wo,
            sigma=self._array("sigma") if "sigma" in self.blocks else None,
            channels=[Channel(c["name"], c["wavelength_nm"]) for c in self.header["channels"]],
            mask=np.unpackbits(self._array("mask"), count=samples).astype(bool),
            symmetry=self.header["symmetry"], metadata=metadata, negatives="keep", duplicates="keep",
        )  # fmt: skip
        table.metadata = metadata  # the counts by reason are the original's, not those of reading it back
        if self.tolerance == 0 and table.hash != self.source_hash:
            raise TableError(
                "the unpacked table is not the one that was compressed", code="compressed-damaged",
                file=metadata.name or None, remedy="compress the original table again",
            )  # fmt: skip
        return table

    def _array(self, name: str) -> NDArray[Any]:
        if name not in self.blocks:
            raise TableError(
                f"the container has no block {name!r}", code="compressed-damaged", column=name,
                remedy="compress the original table again",
            )  # fmt: skip
        return container.unpack(self.blocks[name])

    def _grid(self) -> Grid | None:
        given = self.header["grid"]
        if given is None:
            return None
        axes = {name: self._array(f"axis {name}") for name in given["axes"]}
        return Grid(given["system"], axes, given["periodic"])

    def _channel(self, k: int) -> FloatArray:
        if f"raw {k}" in self.blocks:
            return self._array(f"raw {k}")
        bins = decode(k, self._array, tuple(self.header["shape"]), self.header["prediction"][k])
        value = dequantise(bins, self.header["floor"][k], self.tolerance)
        value[self._array(f"exception index {k}")] = self._array(f"exception value {k}")
        return value


def compress(table: Table, tolerance: float, *, floor: ArrayLike | None = None) -> CompressedTable:
    """``table`` smaller, with |error| <= ``tolerance`` (|f| + ``floor``) for every finite value.

    Parameters
    ----------
    tolerance : relative, in [0, 1); 0 keeps every bit.
    floor : 1/sr, one number or one per channel, positive; default 1 % of the median |f| of each
        channel's usable samples that are not 0.

    Values that are not finite, the mask, sigma, directions or axes, channels and metadata are kept
    exactly. Every value is decoded and checked before this returns; the few that rounding would push
    over the bound are stored as they are.

    Raises
    ------
    SpecError : a tolerance or a floor that makes no sense.
    """
    if not 0 <= tolerance < 1:
        raise SpecError(
            f"tolerance must be at least 0 and below 1, not {tolerance}", code="bad-tolerance",
            parameter="tolerance", remedy="give a relative error such as 0.01; 0 keeps every bit",
        )  # fmt: skip
    channels = len(table.channels)
    floors = _default_floor(table) if floor is None else _given_floor(floor, channels)
    shape = (len(table),) if table.grid is None else table.grid.shape
    blocks: list[Block] = []
    prediction: list[dict[str, Any]] = []
    worst = 0.0
    for k in range(channels):
        value = np.ascontiguousarray(table.value[:, k])
        parts, how, error = _pack_channel(k, value, float(floors[k]), float(tolerance), shape)
        blocks += parts
        prediction.append(how)
        worst = max(worst, error)
    blocks += _pack_geometry(table)
    header: dict[str, Any] = {
        "tolerance": float(tolerance),
        "floor": [float(f) for f in floors],
        "worst_error": worst,
        "source_hash": table.hash,
        "samples": len(table),
        "shape": list(shape),
        "prediction": prediction,
        "channels": [asdict(channel) for channel in table.channels],
        "symmetry": table.symmetry,
        "grid": None
        if table.grid is None
        else {
            "system": table.grid.system,
            "axes": list(table.grid.axes),
            "periodic": {name: float(period) for name, period in table.grid.periodic.items()},
        },
        "metadata": _document(table.metadata),
    }
    return CompressedTable(header, {block.name: block for block in blocks})


def _pack_channel(
    k: int, value: FloatArray, floor: float, tolerance: float, shape: tuple[int, ...]
) -> tuple[list[Block], dict[str, Any], float]:
    """Blocks of one channel, how it is predicted, its worst error in units of the bound."""
    raw = container.pack(f"raw {k}", value)
    if tolerance < SMALLEST_TOLERANCE:
        return [raw], {}, 0.0
    bins = quantise(value, floor, tolerance)
    decoded = dequantise(bins, floor, tolerance)
    error = error_in_bounds(value, decoded, floor, tolerance)
    exact = np.flatnonzero(~(error <= 1.0) | ~np.isfinite(value))
    bins[exact] = 0
    error[exact] = 0.0
    predicted, how = encode(k, bins, shape)
    parts = [
        *predicted,
        container.pack(f"exception index {k}", exact.astype(np.int64)),
        container.pack(f"exception value {k}", value[exact]),
    ]
    if sum(len(part.data) for part in parts) >= len(raw.data):
        return [raw], {}, 0.0
    return parts, how, float(error.max())


def _pack_geometry(table: Table) -> list[Block]:
    if table.grid is None:
        blocks = [container.pack("wi", table.wi), container.pack("wo", table.wo)]
    else:
        blocks = [container.pack(f"axis {name}", axis) for name, axis in table.grid.axes.items()]
    blocks.append(container.pack("mask", np.packbits(table.mask)))
    if table.sigma is not None:
        blocks.append(container.pack("sigma", table.sigma))
    return blocks


def _document(metadata: Metadata) -> dict[str, Any]:
    """Plain JSON types only, as they will be read back."""
    given = {item.name: getattr(metadata, item.name) for item in fields(metadata)}
    return json.loads(json.dumps(given, default=_plain))


def _plain(item: object) -> object:
    if isinstance(item, Mapping):
        return dict(cast("Mapping[str, Any]", item))
    if isinstance(item, np.ndarray | np.generic):
        return item.tolist()
    return str(item)


def _default_floor(table: Table) -> FloatArray:
    floors = np.ones(table.value.shape[1])
    for k in range(len(floors)):
        size = np.abs(table.value[table.mask, k])
        size = size[size > 0]
        if size.size:
            floors[k] = max(float(np.median(0.01 * size)), np.finfo(np.float64).tiny)
    return floors


def _given_floor(floor: ArrayLike, channels: int) -> FloatArray:
    given = np.asarray(floor, np.float64)
    if given.shape not in ((), (1,), (channels,)) or not (np.isfinite(given) & (given > 0)).all():
        raise SpecError(
            f"floor must be a positive number, or one per channel ({channels})", code="bad-floor",
            parameter="floor", remedy="leave it out for 1 % of each channel's median",
        )  # fmt: skip
    return np.broadcast_to(given, (channels,)).copy()
