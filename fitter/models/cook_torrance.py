"""Cook-Torrance: Torrance-Sparrow's facets of a metal or dielectric, with the exact Fresnel term.

ks F D G / (4 cos_i cos_o) + kd/pi, D Beckmann or GGX, G of V-grooves. R. Cook and K. Torrance 1982 print
pi for the 4, with a D that lacks its own 1/pi: normalised as here, the energy balances.
"""

from __future__ import annotations

from typing import ClassVar

from fitter.models.torrance_sparrow import TorranceSparrow


class CookTorrance(TorranceSparrow):
    family: ClassVar[str] = "cook_torrance"
