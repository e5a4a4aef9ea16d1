"""CompressedTable: a table made smaller with a guaranteed error bound on every measured value."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter.compression import coding, container
from fitter.compression.arrangement import TILE, shape_of
from fitter.compression.bound import bound_from_noise, default_floor, given_floor
from fitter.compression.coding import Scale
from fitter.compression.container import Block, Damage, array_block, array_of
from fitter.compression.directions import direction_block, directions_of
from fitter.compression.folds import Folds
from fitter.compression.scale import error_in_bounds
from fitter.compression.tiles import Tiles
from fitter.documents import write_bytes
from fitter.errors import SpecError, TableError
from fitter.grid import Grid
from fitter.metadata import Channel, Metadata
from fitter.table import Table

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Why samples are masked that stood in a damaged block.
DAMAGED = "in a damaged block"


@dataclass(frozen=True)
class CompressedTable:
    """A table in its packed form.

    header : JSON-ready description: tolerance, floors, geometry, channels, metadata, hash of the original.
    blocks : the readable blocks by name. damaged : what is wrong with each of the others.
    """

    header: Mapping[str, Any]
    blocks: Mapping[str, Block]
    damaged: Mapping[str, str] = field(default_factory=dict[str, str])

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
    def mean_error(self) -> FloatArray:
        """(C,) mean signed error of the finite values, in units of the guarantee."""
        return np.array(self.header["mean_error"], np.float64)

    @property
    def rms_error(self) -> FloatArray:
        """(C,) root mean square error of the finite values, in units of the guarantee."""
        return np.array(self.header["rms_error"], np.float64)

    @property
    def source_hash(self) -> str:
        """``Table.hash`` of the table that was compressed."""
        return str(self.header["source_hash"])

    @cached_property
    def nbytes(self) -> int:
        """Size of the container in bytes."""
        return len(self.to_bytes())

    @property
    def value_bytes(self) -> int:
        """Bytes of the blocks that hold the values alone."""
        return sum(len(b.data) for b in self.blocks.values() if b.name.startswith("values "))

    @property
    def ratio(self) -> float:
        """Bytes of the values as float64, over :attr:`nbytes` (which includes directions, sigma and mask)."""
        return 8.0 * self.header["samples"] * len(self.header["channels"]) / self.nbytes

    def describe(self) -> dict[str, Any]:
        """What the container promises and how large it is, JSON-ready."""
        return {
            "bytes": self.nbytes, "value_bytes": self.value_bytes, "ratio": self.ratio,
            "tolerance": self.tolerance, "floor_per_sr": self.floor.tolist(), "worst_error": self.worst_error,
            "mean_error": self.mean_error.tolist(), "rms_error": self.rms_error.tolist(),
            "version": container.VERSION, "tiles": self.tiles.count, "damaged": dict(self.damaged),
            "hash": self.source_hash,
        }  # fmt: skip

    def to_bytes(self) -> bytes:
        """The container file."""
        return container.encode(self.header, list(self.blocks.values()))

    def save(self, path: str | PathLike[str]) -> None:
        """Write the container; written aside and renamed, so that it is never half there."""
        write_bytes(self.to_bytes(), Path(path))

    @classmethod
    def load(cls, path: str | PathLike[str], *, damage: Damage = "refuse") -> CompressedTable:
        """Read a container. Raises TableError naming the damaged block, or OSError.

        ``damage`` "keep" reads the blocks that are whole; samples of the others come back masked, as NaN.
        """
        path = Path(path)
        return cls.from_bytes(path.read_bytes(), file=path.name, damage=damage)

    @classmethod
    def from_bytes(
        cls, data: bytes, file: str | None = None, *, damage: Damage = "refuse"
    ) -> CompressedTable:
        """The container in ``data``; ``file`` only names it in errors."""
        header, blocks, damaged = container.decode(data, file, damage)
        return cls(header, blocks, damaged)

    def decompress(self) -> Table:
        """The table again: masks, sigma, channels, geometry and metadata exactly, values within the bound.

        Raises
        ------
        TableError : a block that can't be unpacked, or a lossless table whose hash is not the original's.
        """
        value, lost = self.tiles.all()
        mask = np.unpackbits(self._array("mask"), count=len(value)).astype(bool)
        document: dict[str, Any] = dict(self.header["metadata"])
        document["notes"] = (*document["notes"], *self.damaged.values())
        if lost.any():
            document["masked"] = {**document["masked"], DAMAGED: int(np.count_nonzero(lost & mask))}
        metadata = Metadata(**document)
        sigma = None if "sigma" in self.damaged or not self.header["sigma"] else self._array("sigma")
        wi, wo = (None if self.grid is not None else self._directions(name) for name in ("wi", "wo"))
        table = Table(
            value=value, grid=self.grid, wi=wi, wo=wo, sigma=sigma, channels=self._channels,
            mask=mask & ~lost, symmetry=self.header["symmetry"], metadata=metadata, negatives="keep",
            duplicates="keep",
        )  # fmt: skip
        table.metadata = metadata  # the counts by reason are the original's, not those of reading it back
        if self.tolerance == 0 and not self.damaged and table.hash != self.source_hash:
            raise TableError(
                "the unpacked table is not the one that was compressed", code="compressed-damaged",
                file=metadata.name or None, remedy="compress the original table again",
            )  # fmt: skip
        return table

    def values(self, index: ArrayLike) -> FloatArray:
        """(n, C) values in 1/sr of the samples ``index`` (n,); only their tiles are unpacked, and kept.

        Raises TableError where one of them is in a damaged block.
        """
        return self.tiles.values(np.asarray(index, np.intp))

    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> tuple[FloatArray, BoolArray]:
        """As :meth:`fitter.table.Table.evaluate`, of the decompressed table.

        Of a grid only the tiles that hold nodes about the directions are unpacked, and kept (in incoming and
        outgoing angles: all nodes of the incidences about them, whose energy decides how they are
        interpolated); a scattered table is unpacked once as a whole, since its triangles need all directions.
        """
        return self._interpolant.evaluate(np.asarray(wi, np.float64), np.asarray(wo, np.float64))

    @cached_property
    def tiles(self) -> Tiles:
        """The values, a tile at a time."""
        stated = self.header["values"]
        used = Scale(self.tolerance, self.floor, float(stated["step"]))
        folds = Folds.from_document(stated, stated["shape"])
        return Tiles(self.blocks, self.damaged, used, folds)

    @cached_property
    def grid(self) -> Grid | None:
        """As of the table."""
        given = self.header["grid"]
        if given is None:
            return None
        axes = {name: self._array(f"axis {name}") for name in given["axes"]}
        return Grid(given["system"], axes, given["periodic"])

    @cached_property
    def _interpolant(self) -> Any:
        from fitter.sampling.grid import GridInterpolant
        from fitter.sampling.interpolant import interpolant

        if self.grid is None:
            return interpolant(self.decompress())
        mask = np.unpackbits(self._array("mask"), count=self.header["samples"]).astype(bool)
        # Looks like an array of values as far as an interpolant looks: its shape, and picked rows.
        return GridInterpolant(self.grid, cast("FloatArray", self.tiles), mask)

    @property
    def _channels(self) -> list[Channel]:
        return [Channel(c["name"], c["wavelength_nm"]) for c in self.header["channels"]]

    def _block(self, name: str) -> Block:
        if name not in self.blocks:
            message = self.damaged.get(name, f"the container has no block {name!r}")
            raise container.damaged(message, None, name)
        return self.blocks[name]

    def _array(self, name: str) -> NDArray[Any]:
        return array_of(self._block(name))

    def _directions(self, name: str) -> FloatArray:
        return directions_of(self._block(name))


def compress(
    table: Table, tolerance: float | Literal["noise"], *,
    floor: ArrayLike | Mapping[str, float] | None = None, tile: int = TILE,
) -> CompressedTable:  # fmt: skip
    """``table`` smaller, with |error| <= ``tolerance`` (|f| + ``floor``) for every finite value.

    Parameters
    ----------
    tolerance : relative, in [0, 1); 0 keeps every bit; "noise": the bound is one standard deviation of the
        table's noise, stated or estimated (:func:`fitter.compression.bound.bound_from_noise`).
    floor : 1/sr, one number, one per channel, or some by channel name, positive; default 1 % of the median
        |f| of each channel's usable samples that are not 0, and with "noise" what that says.
    tile : samples of a tile, the part that can be unpacked alone.

    Values that are not finite, the mask, sigma, directions or axes, channels and metadata are kept
    exactly. Every value is decoded and checked before this returns; the few that rounding would push
    over the bound are stored as they are.

    Raises
    ------
    SpecError : a tolerance or a floor that makes no sense, or noise that the table doesn't tell.
    """
    channels = len(table.channels)
    if tolerance == "noise":
        tolerance, floors = bound_from_noise(table)
    elif 0 <= tolerance < 1:
        floors = default_floor(table)
    else:
        raise SpecError(
            f"tolerance must be at least 0 and below 1, not {tolerance}", code="bad-tolerance",
            parameter="tolerance", remedy="give a relative error such as 0.01; 0 keeps every bit",
        )  # fmt: skip
    if floor is not None:
        floors = given_floor(floor, [channel.name for channel in table.channels], floors)
    shape = shape_of(table)
    coded = coding.encode(table.value, shape, float(tolerance), floors, tile)
    tolerance = coded.scale.tolerance
    error = np.zeros((1, channels))
    if tolerance:
        error = error_in_bounds(table.value, coded.decoded, floors, tolerance)
    header: dict[str, Any] = {
        "tolerance": tolerance,
        "floor": [float(f) for f in floors],
        "worst_error": float(np.abs(error).max()),
        "mean_error": error.mean(axis=0).tolist(),
        "rms_error": np.sqrt(np.square(error).mean(axis=0)).tolist(),
        "source_hash": table.hash,
        "samples": len(table),
        "values": {"shape": list(shape), "step": coded.scale.step, **coded.folds.document()},
        "channels": [asdict(channel) for channel in table.channels],
        "symmetry": table.symmetry,
        "sigma": table.sigma is not None,
        "grid": None
        if table.grid is None
        else {
            "system": table.grid.system,
            "axes": list(table.grid.axes),
            "periodic": {name: float(period) for name, period in table.grid.periodic.items()},
        },
        "metadata": _document(table.metadata),
    }
    blocks = [*_geometry(table), *coded.blocks]
    return CompressedTable(header, {block.name: block for block in blocks})


def _geometry(table: Table) -> list[Block]:
    if table.grid is None:
        blocks = [direction_block("wi", table.wi), direction_block("wo", table.wo)]
    else:
        blocks = [array_block(f"axis {name}", axis) for name, axis in table.grid.axes.items()]
    blocks.append(array_block("mask", np.packbits(table.mask)))
    if table.sigma is not None:
        blocks.append(array_block("sigma", table.sigma))
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
