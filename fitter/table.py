"""Table: what was measured, on what grid, over what domain."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fitter import directions
from fitter.domain import Domain, domain
from fitter.errors import TableError
from fitter.grid import Grid
from fitter.masking import HORIZON, Treatment, reasons
from fitter.metadata import Channel, Metadata, Symmetry
from fitter.parts import in_parts
from fitter.repeats import repeated
from fitter.summary import Summary, summarise

if TYPE_CHECKING:
    from fitter.sampling.interpolant import Interpolant

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


class Table:
    """Measured reflectance f_r(wi, wo) in 1/sr, without the cosine.

    Parameters
    ----------
    wi, wo : (N, 3) unit vectors away from the surface; leave both out when ``grid`` is given.
    value : (N, C) or (N,) f_r in 1/sr, in the grid's storage order. Kept exactly as given.
    sigma : (N, C), random standard uncertainty (k = 1) in 1/sr, or None where not measured.
    channels : names or :class:`Channel`; default "value", "R G B" for three, else "c0", "c1", ...
    grid : the product grid the samples lie on, or None when scattered.
    mask : (N,) False for samples the caller knows to be unusable.
    fills : (N,) True for samples that hold a fill value instead of a measured one.
    negatives : "mask" (the default) or "keep": whether negative values count as usable.
    duplicates : "mask" (all but the first of each geometry, the default) or "keep".
    copy : False takes ``wi`` and ``wo`` over where they are float64 in C order, and may change them: z within
        1e-9 of the horizon becomes 0.

    Attributes
    ----------
    A viewer exactly on the horizon is usable as a measured value, though every model returns 0 there; a light
    on the horizon gives no irradiance, and f_r is undefined.

    fills : (N,) as given, or None.
    mask : (N,) True where usable. Masked samples keep their values and are counted by reason in
        ``metadata.masked``: fill values, non-finite or negative values, directions below the horizon, sigma
        that is not positive, repeated geometries.

    Raises
    ------
    TableError : shapes that don't match, vectors that aren't unit vectors, nothing usable.
    """

    def __init__(
        self,
        *,
        wi: ArrayLike | None = None,
        wo: ArrayLike | None = None,
        value: ArrayLike,
        sigma: ArrayLike | None = None,
        channels: Sequence[str | Channel] | None = None,
        grid: Grid | None = None,
        mask: ArrayLike | None = None,
        fills: ArrayLike | None = None,
        symmetry: Symmetry | None = None,
        metadata: Metadata | None = None,
        negatives: Treatment = "mask",
        duplicates: Treatment = "mask",
        copy: bool = True,
    ) -> None:
        self.metadata = metadata or Metadata()
        #: Seconds that reading it took, of several tables of one source its share; None where nobody knows.
        self.load_seconds: float | None = None
        #: What lies between the samples where the file says so itself (adaptive parameterisations).
        self.between: Interpolant | None = None
        self.grid = grid
        self.value = _columns("value", value)
        n = len(self.value)
        if n == 0:
            raise self._error(
                "the table holds no samples", "table-empty", remedy="check that the file is whole"
            )
        self._wi, self._wo = self._check_directions(wi, wo, n, copy)
        self.sigma = None if sigma is None else _columns("sigma", sigma)
        if self.sigma is not None and self.sigma.shape != self.value.shape:
            raise self._error(
                f"sigma has shape {self.sigma.shape}, value {self.value.shape}", "table-shape",
                parameter="sigma", remedy="give one standard uncertainty per value",
            )  # fmt: skip
        self.channels = _channels(channels, self.value.shape[1])
        self.fills = self._flags("fills", fills, n)
        marked = self._flags("mask", mask, n)
        found = reasons(self, marked, negatives, duplicates)
        self.mask: BoolArray = np.ones(n, bool)
        counts = dict(self.metadata.masked)
        usable = n
        for reason, bad in found.items():
            np.greater(self.mask, bad, out=self.mask)  # and not bad, in place
            left = int(np.count_nonzero(self.mask))
            if left < usable:
                counts[reason] = counts.get(reason, 0) + usable - left
            usable = left
        self.metadata = self.metadata.but(masked=counts)
        if not self.mask.any():
            raise self._error(
                f"none of the {n} samples is usable ({_counted(counts)})", "table-nothing-usable",
                cause="a wrong unit, quantity or convention, or a file of fill values",
                remedy="check how the columns were declared",
            )  # fmt: skip
        self.symmetry: Symmetry = symmetry or self._guess_symmetry()

    def _check_directions(
        self, wi: ArrayLike | None, wo: ArrayLike | None, n: int, copy: bool
    ) -> tuple[FloatArray | None, FloatArray | None]:
        if self.grid is not None:
            if wi is not None or wo is not None:
                raise self._error("give either a grid or directions, not both", "table-shape")
            if self.grid.size != n:
                raise self._error(
                    f"the grid has {self.grid.size} cells {self.grid.shape}, value {n} rows", "table-shape"
                )
            return None, None
        if wi is None or wo is None:
            raise self._error("a scattered table needs both wi and wo", "table-shape")
        pair: list[FloatArray] = []
        for name, given in (("wi", wi), ("wo", wo)):
            w = np.array(given, np.float64, order="C", copy=copy or None)
            if w.shape != (n, 3):
                raise self._error(
                    f"{name} has shape {w.shape}, expected ({n}, 3)", "table-shape", parameter=name
                )
            off = _not_unit(w)
            if off is not None:
                raise self._error(
                    f"row {off + 1} of {name} is not a unit vector", "table-not-unit",
                    parameter=name, remedy="divide each direction by its length",
                )  # fmt: skip
            pair.append(w)
        return pair[0], pair[1]

    def _flags(self, name: str, given: ArrayLike | None, n: int) -> BoolArray | None:
        flags = None if given is None else np.asarray(given, bool)
        if flags is not None and flags.shape != (n,):
            raise self._error(
                f"{name} has shape {flags.shape}, expected ({n},)", "table-shape", parameter=name
            )
        return flags

    @cached_property
    def repeats(self) -> BoolArray:
        """(N,) True for every sample whose geometry an earlier sample has (scattered tables)."""
        if self.grid is not None:
            return np.zeros(len(self), bool)
        return repeated(self.wi, self.wo)

    def _guess_symmetry(self) -> Symmetry:
        if self.grid is not None:
            return "anisotropic" if self.grid.system == "spherical" else "isotropic"
        # One incident azimuth only: the table can't tell, and the isotropic reading is the usual one.
        usable = np.flatnonzero(self.mask)
        some = usable[:: len(usable) // 10_000 + 1]
        # What some of the samples span is never more than what all of them do.
        one = all(_azimuths(self.wi[rows]) < 1e-3 for rows in (some, usable))
        return "isotropic" if one else "anisotropic"

    def _error(self, message: str, code: str, **keywords: Any) -> TableError:
        return TableError(message, code=code, file=self.metadata.name or None, **keywords)

    def __len__(self) -> int:
        return len(self.value)

    @property
    def usable(self) -> int:
        """How many samples are usable."""
        return int(self.mask.sum())

    def __repr__(self) -> str:
        names = ", ".join(channel.name for channel in self.channels)
        kind = "scattered" if self.grid is None else f"{self.grid.system} grid {self.grid.shape}"
        usable = int(self.mask.sum())
        return f"<Table {self.metadata.name!r}: {len(self)} samples, {usable} usable, [{names}], {kind}>"

    @property
    def wi(self) -> FloatArray:
        """(N, 3) directions towards the light; computed from the grid when asked for, not stored."""
        if self._wi is not None:
            return self._wi
        assert self.grid is not None
        return self.grid.directions()[0]

    @property
    def wo(self) -> FloatArray:
        """(N, 3) directions towards the viewer; computed from the grid when asked for, not stored."""
        if self._wo is not None:
            return self._wo
        assert self.grid is not None
        return self.grid.directions()[1]

    def directions(self, index: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """``(wi, wo)`` of the samples ``index`` only, each (n, 3)."""
        if self.grid is not None:
            return self.grid.directions(index)
        assert self._wi is not None
        assert self._wo is not None
        return self._wi[index], self._wo[index]

    @cached_property
    def domain(self) -> Domain:
        """Range of the usable samples."""
        return domain(self)

    @cached_property
    def summary(self) -> Summary:
        """Of the usable values, channel by channel."""
        return summarise(self.value, self.mask)

    @cached_property
    def hash(self) -> str:
        """sha256 of what was measured (geometry, values, sigma, mask, channels): the table's identity."""
        digest = hashlib.sha256()
        if self.grid is not None:
            digest.update(self.grid.system.encode())
            parts: list[NDArray[Any]] = list(self.grid.axes.values())
        else:
            parts = [self.wi, self.wo]
        for part in [*parts, self.value, *([] if self.sigma is None else [self.sigma]), self.mask]:
            digest.update(str(part.shape).encode())
            for start in range(0, len(part), 1 << 18):  # a whole copy of a transposed array is not needed
                digest.update(np.ascontiguousarray(part[start : start + (1 << 18)]).data)
        digest.update(repr(self.channels).encode())
        return digest.hexdigest()

    def evaluate(self, wi: ArrayLike, wo: ArrayLike) -> tuple[FloatArray, BoolArray]:
        """Interpolated values (M, C) in 1/sr and (M,) flags: True where outside the measured domain.

        How each kind of table is interpolated is defined in :mod:`fitter.sampling.interpolant`.
        """
        from fitter.sampling.interpolant import interpolant

        return interpolant(self).evaluate(np.asarray(wi, np.float64), np.asarray(wo, np.float64))

    def plot(self) -> Any:
        """The table's picture as a ``matplotlib.figure.Figure``: slices, angles covered, hemispheres.

        It is what ``brdf-fitter info --plot`` writes; ``table.plot().savefig("table.png")`` does the same.
        """
        from fitter.report.portrait import portrait
        from fitter.report.portrait_figure import draw

        return draw(portrait(self))

    def to_arrow(self) -> Any:
        """A ``pyarrow.Table``: float64 columns, the rest stated in the schema's metadata.

        :func:`fitter.load` reads it, and what the other three give, as this table again; see
        ``docs/python.md`` for what each of them can hold.
        """
        from fitter.formats.arrow import arrow_table

        return arrow_table(self)

    def to_pandas(self) -> Any:
        """A ``pandas.DataFrame``, the statements in its ``attrs``. Raises TableError without pandas."""
        from fitter.formats.arrow import pandas_frame

        return pandas_frame(self)

    def to_polars(self) -> Any:
        """A ``polars.DataFrame``, which has no place for statements. Raises TableError without Polars."""
        from fitter.formats.arrow import polars_frame

        return polars_frame(self)

    def to_xarray(self) -> Any:
        """An ``xarray.Dataset``; a grid's axes are its coordinates. Raises TableError without xarray."""
        from fitter.formats.xarrays import dataset

        return dataset(self)

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """The columns of :meth:`to_arrow`, for every library that takes an Arrow C stream."""
        return self.to_arrow().__arrow_c_stream__(requested_schema)


def _azimuths(w: FloatArray) -> float:
    """The range (radians) of the azimuths of directions (n, 3) that are not the normal."""
    theta, phi = directions.spherical_from_vector(w)
    tilted = theta > 1e-3
    return float(np.ptp(np.unwrap(np.sort(phi[tilted])))) if tilted.any() else 0.0


def _not_unit(w: FloatArray) -> int | None:
    """The first row of (n, 3) that is finite and no unit vector. Sets those about on the horizon on it."""
    found: list[int] = []

    def check(rows: slice) -> None:
        part = w[rows]
        off = np.abs(np.einsum("ij,ij->i", part, part) - 1.0) > 1e-6
        if off.any():
            off &= np.isfinite(part).all(axis=1)
        if off.any():
            found.append(rows.start + int(np.argmax(off)))
        z = part[:, 2]
        z[np.abs(z) < HORIZON] = 0.0

    in_parts(check, len(w))
    return min(found, default=None)


def _columns(name: str, given: ArrayLike) -> FloatArray:
    array = np.asarray(given, np.float64)
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[1] == 0:
        raise TableError(
            f"{name} has shape {array.shape}, expected (N, C)", code="table-shape", parameter=name
        )
    return array


def _channels(given: Sequence[str | Channel] | None, count: int) -> tuple[Channel, ...]:
    if given is None:
        names = {1: ["value"], 3: ["R", "G", "B"]}.get(count, [f"c{k}" for k in range(count)])
        return tuple(Channel(name) for name in names)
    channels = tuple(c if isinstance(c, Channel) else Channel(c) for c in given)
    if len(channels) != count or len({c.name for c in channels}) != count:
        raise TableError(
            f"{len(channels)} channels ({', '.join(c.name for c in channels)}) for {count} value columns",
            code="table-channels", parameter="channels", remedy="give one distinct name per column",
        )  # fmt: skip
    return channels


def _counted(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in counts.items())
