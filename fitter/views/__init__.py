"""Views of a table that a person looks at piece by piece: small arrays, however large the table is."""

from __future__ import annotations

from fitter.views.half_difference import HalfDifference, half_difference
from fitter.views.interpolated import InPlane, Lobe, in_plane, lobe
from fitter.views.kept import Coverage, Cuts, Views

__all__ = [
    "Coverage", "Cuts", "HalfDifference", "InPlane", "Lobe", "Views", "half_difference", "in_plane", "lobe",
]  # fmt: skip
