"""Angle bases of WINDOW's BSDF files: the hemisphere in bands of theta, each cut into equal patches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitter.formats.source import Source
from fitter.formats.text import number
from fitter.formats.xml_tree import Element

FloatArray = NDArray[np.float64]

#: No basis has more bands, or patches in one: larger counts are damage.
_BANDS, _PATCHES = 180, 3600


@dataclass(frozen=True)
class Basis:
    """Centres of the patches (n,) in the file's order, degrees. Patch 0 of a band is centred on azimuth 0."""

    name: str
    theta: FloatArray
    phi: FloatArray

    def __len__(self) -> int:
        return len(self.theta)


def _basis(name: str, theta: Sequence[float], counts: Sequence[int]) -> Basis:
    phi = [360.0 * np.arange(n) / n for n in counts]
    return Basis(name, np.repeat(np.asarray(theta, np.float64), counts), np.concatenate(phi))


#: The bases a file may name without declaring them, as Radiance's bsdf2klems declares them.
KNOWN: Mapping[str, Basis] = {
    basis.name.lower(): basis
    for basis in (
        _basis("LBNL/Klems Full", (0, 10, 20, 30, 40, 50, 60, 70, 82.5), (1, 8, 16, 20, 24, 24, 24, 16, 12)),
        _basis("LBNL/Klems Half", (0, 13, 26, 39, 52, 65, 80.75), (1, 8, 12, 16, 20, 12, 8)),
        _basis("LBNL/Klems Quarter", (0, 18, 36, 54, 76.5), (1, 8, 12, 12, 8)),
    )
}


def declared_basis(source: Source, element: Element) -> Basis:
    """The basis an AngleBasis element declares; one that only gives a name must be a known one."""
    name = element.words("AngleBasisName") or element.words("Name")
    blocks = list(element.all("AngleBasisBlock"))
    if not blocks:
        return known_basis(source, name, element.row)
    if len(blocks) > _BANDS:
        raise _damaged(source, element, f"the basis {name[:40]!r} has {len(blocks)} bands")
    theta: list[float] = []
    counts: list[int] = []
    below = 0.0
    for block in blocks:
        lower = _angle(source, block, "ThetaBounds", "LowerTheta")
        upper = _angle(source, block, "ThetaBounds", "UpperTheta")
        count = _number(source, block, "nPhis")
        if not (1 <= count <= _PATCHES and count == int(count)):
            raise _damaged(source, block, f"nPhis is {count:g}")
        if not lower < upper or abs(lower - below) > 1e-3:
            raise _damaged(source, block, f"a band from {lower:g} to {upper:g} deg follows one to {below:g}")
        # A single patch about the normal is a cap: its centre is the normal.
        centre = 0.0 if count == 1 and lower == 0 else 0.5 * (lower + upper)
        if block.first("Theta") is not None:
            centre = _angle(source, block, "Theta")
            if not lower <= centre <= upper:
                raise _damaged(source, block, f"Theta {centre:g} is outside its band, {lower:g} to {upper:g}")
        theta.append(centre)
        counts.append(int(count))
        below = upper
    return _basis(name, theta, counts)


def known_basis(source: Source, name: str, row: int) -> Basis:
    """One of ``KNOWN``. Raises TableError for another name."""
    if name.lower() in KNOWN:
        return KNOWN[name.lower()]
    raise source.error(
        f"the angle basis {name[:40]!r} is neither declared in the file nor known", "table-header", row=row,
        column="AngleBasis", cause="a damaged header" if not name else None,
        remedy="declare it in an AngleBasis element; known without are "
        + ", ".join(basis.name for basis in KNOWN.values()),
    )  # fmt: skip


def _angle(source: Source, block: Element, *path: str) -> float:
    degrees = _number(source, block, *path)
    if not 0 <= degrees <= 90:
        raise _damaged(source, block, f"{path[-1]} is {degrees:g} deg")
    return degrees


def _number(source: Source, block: Element, *path: str) -> float:
    found = number(block.words(*path))
    if found is None or not np.isfinite(found):
        raise _damaged(source, block, f"{path[-1]} is {block.words(*path)[:40]!r}")
    return found


def _damaged(source: Source, element: Element, what: str) -> Exception:
    return source.error(
        f"the angle basis can't be used: {what}", "table-header", row=element.row, column="AngleBasis",
        cause="a damaged header", remedy="fetch the file again, or correct the AngleBasis element",
    )  # fmt: skip
