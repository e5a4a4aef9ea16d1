"""The vocabulary of column names: what a column of a delimited text table holds, and in which unit."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from fitter.metadata import Quantity

Kind = Literal["angle", "component", "value", "sigma", "usable", "wavelength", "item", "ignore"]

_DIRECTION = {
    "i": "i", "in": "i", "l": "i", "o": "o", "out": "o", "r": "o", "s": "o", "v": "o", "h": "h", "d": "d",
}  # fmt: skip
_ANGLE = re.compile(r"(?:(theta|phi)_?(in|out|[ilorsvhd])|(dphi))(?:_(deg|rad)\w*)?", re.IGNORECASE)
_COMPONENT = re.compile(r"(wi|wo)_?([xyz])", re.IGNORECASE)
_VALUE = re.compile(
    r"(?:(brdf|f_?r)|(ccbrdf|dsf)|(reflectance_factor)|(value))(?:_per_sr)?(?:_([\w.+-]+))?", re.IGNORECASE
)
_SIGMA = re.compile(
    r"sigma(?:_(?:(brdf|f_?r)|(ccbrdf|dsf)|(reflectance_factor)|(value)))?(?:_per_sr)?(?:_([\w.+-]+))?",
    re.IGNORECASE,
)
_WAVELENGTH = re.compile(r"(?:wavelength|lambda)_(nm|um)", re.IGNORECASE)
_BAND = re.compile(r"(\d+(?:\.\d+)?)_?(nm|um)", re.IGNORECASE)
_QUANTITIES: tuple[Quantity, ...] = ("brdf", "ccbrdf", "reflectance_factor")

#: What to say when a column has to be declared.
VOCABULARY = (
    "angles theta_i, phi_i, theta_o, phi_o, dphi (= phi_o - phi_i), theta_h, theta_d, phi_d with _deg or "
    "_rad; vector components wi_x ... wo_z; values brdf, ccbrdf, reflectance_factor or value, and sigma, "
    "each with _<channel> as in brdf_R or brdf_550nm; wavelength_nm, wavelength_um, item, usable, ignore"
)


@dataclass(frozen=True)
class Column:
    """A declared column.

    role : "theta_i" ... "phi_d", "wi_x" ... "wo_z" for geometry; otherwise the kind.
    unit : "deg" or "rad" for angles (None where not declared), "nm" or "um" for a wavelength.
    quantity, channel : for values and sigmas; None and "" where the name doesn't say.
    """

    kind: Kind
    role: str
    unit: str | None = None
    quantity: Quantity | None = None
    channel: str = ""


def parse_column(name: str) -> Column | None:
    """What a column called ``name`` holds, or None when its name is not in the vocabulary."""
    word = _tidy(name)
    if match := _ANGLE.fullmatch(word):
        letter, direction, dphi, unit = match.groups()
        role = "dphi" if dphi else f"{letter.lower()}_{_DIRECTION[direction.lower()]}"
        return Column("angle", role, unit.lower() if unit else None)
    if match := _COMPONENT.fullmatch(word):
        return Column("component", f"{match[1]}_{match[2]}".lower())
    if match := _WAVELENGTH.fullmatch(word):
        return Column("wavelength", "wavelength", match[1].lower())
    if word.lower() in ("usable", "item", "ignore"):
        kind: Kind = "usable" if word.lower() == "usable" else "item" if word.lower() == "item" else "ignore"
        return Column(kind, kind)
    if match := _VALUE.fullmatch(word):
        return Column("value", "value", quantity=_quantity(match), channel=match[5] or "")
    if match := _SIGMA.fullmatch(word):
        return Column("sigma", "sigma", quantity=_quantity(match), channel=match[5] or "")
    return None


def band_nm(channel: str) -> float | None:
    """Wavelength in nm of a channel called like 550nm or 0.55um; None for other names."""
    match = _BAND.fullmatch(channel.strip())
    if not match:
        return None
    return float(match[1]) * (1000.0 if match[2].lower() == "um" else 1.0)


def _quantity(match: re.Match[str]) -> Quantity | None:
    return next((_QUANTITIES[k] for k in range(3) if match[k + 1]), None)


def _tidy(name: str) -> str:
    """Spelling variants of one name: "theta_i [deg]", "Theta-i (deg)" and "theta_i_deg" are the same."""
    word = re.sub(r"[\[(]\s*(?:1/sr|sr\^?-1|/sr)\s*[\])]", "_per_sr", name.strip(), flags=re.IGNORECASE)
    word = re.sub(r"[\[\](){}\s]+", "_", word)
    return re.sub(r"_+", "_", word).strip("_")
