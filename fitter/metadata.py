"""What is known of a table beside its values: channels, quantity, where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from fitter.digest import DigestField, Sha256

Symmetry = Literal["isotropic", "anisotropic"]
Quantity = Literal["brdf", "ccbrdf", "reflectance_factor"]
QUANTITIES: tuple[Quantity, ...] = ("brdf", "ccbrdf", "reflectance_factor")


@dataclass(frozen=True)
class Channel:
    """One measured channel: its name and, where it is a line or a narrow band, its wavelength in nm."""

    name: str
    wavelength_nm: float | None = None


@dataclass(frozen=True)
class Metadata:
    """Where a table comes from and what was done to it on reading. Everything here is JSON-ready.

    ``quantity`` is what the *file* held; ``Table.value`` is always f_r in 1/sr without the cosine.
    ``angle_unit`` is the file's, "deg" or "rad", "" where it holds no angles; here they are always radians.
    ``scale_uncertainty`` is relative and common to the whole table, ``angle_uncertainty`` and
    ``aperture`` (receiver, full angle) are in radians; each is standard (k = 1), None where not stated.
    ``masked`` counts the samples masked by each reason. ``notes`` are sentences a person should read.
    """

    name: str = ""
    source_format: str = "arrays"
    quantity: Quantity = "brdf"
    convention: str = ""
    angle_unit: str = ""
    sha256: Sha256 = DigestField()  # noqa: RUF009  # reads as str; a file's may still be on its way
    scale_uncertainty: float | None = None
    angle_uncertainty: float | None = None
    aperture: float | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict[str, Any])
    masked: Mapping[str, int] = field(default_factory=dict[str, int])
    notes: tuple[str, ...] = ()

    def but(self, **changes: Any) -> Metadata:
        """A copy with other values, as ``dataclasses.replace``, that does not wait for ``sha256``."""
        return Metadata(**{**vars(self), **changes})

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "sha256": self.sha256}  # no thread can be pickled

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
