"""Integra DDR and SDR text.

DDR: luminance or intensity coefficients on polar grids about the specular direction.

A value of 1 is a white diffuser's, so luminance data are reflectance factors and intensity data have the
cosine in them; "Absolute" values are multiplied by the block's kbdf, as libbsdf (K. Ryo) reads these files.
"Relative" values are scaled so that kbdf is the reflectance, which needs an integral over the whole
hemisphere: refused.

SDR: specular reflectance (a ratio, not per sr) for each angle of incidence. It is the weight of a mirror's
delta function: told, as the contents of a NoTable, and refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.errors import NoTable
from fitter.formats import geometry as geo
from fitter.formats import specular
from fitter.formats.assemble import ABOUT_SPECULAR, QUANTITY_REMEDY, Reading, assemble, stated_quantity
from fitter.formats.fills import trailing_zeros
from fitter.formats.read_options import ReadOptions
from fitter.formats.registry import Format
from fitter.formats.sniffing import found
from fitter.formats.source import Source
from fitter.formats.tokens import Tokens
from fitter.metadata import Channel, Quantity
from fitter.table import Table

FloatArray = NDArray[np.float64]

NAME = "integra"
_CHANNELS = {"red": "R", "gre": "G", "green": "G", "blu": "B", "blue": "B"}
_LISTS = {"psi": 360.0, "sigma": 90.0, "phi": 360.0, "theta": 180.0}
_SYMMETRIES = ("AxiSymmetrical", "DirSymmetrical", "PlaneSymmetrical", "ASymmetrical")


def sniff(head: bytes, size: int) -> float:
    """Sure of a text with TypeColorModel and TypeSym or sigma lines."""
    colours, symmetry = (
        found(rb"(?:^|[\r\n])[ \t]*(?:" + b"|".join(keys) + rb")[ \t]", head, *keys, folded=True)
        for keys in ((b"TypeColorModel",), (b"TypeSym", b"sigma"))
    )
    return (0.96 if symmetry else 0.55) if colours else 0.0


@dataclass
class _Head:
    words: dict[str, str] = field(default_factory=dict[str, str])
    lists: dict[str, FloatArray] = field(default_factory=dict[str, FloatArray])
    count: int = 1


def read(source: Source, options: ReadOptions) -> list[Table]:
    """The table of a DDR file. Raises NoTable for transmission and for SDR (specular reflectance only)."""
    tokens = Tokens(source, ";")
    head = _head(tokens)
    transmission = bool(source.name and source.name.lower().endswith((".ddt", ".sdt")))
    if "sigma" in head.lists and not {"phi", "theta"} & set(head.lists):
        raise _specular_only(source, tokens, head, "transmittance" if transmission else "reflectance")
    if transmission:
        raise source.no_table(
            "Integra calls files of transmission .ddt and .sdt", "table-transmission", "transmission",
            remedy="use the .ddr file; if this is one that was renamed, call it so",
        )  # fmt: skip
    _complete(tokens, head)
    quantity, notes = _quantity(tokens, head, options)
    psi, sigma, phi, theta = (head.lists[key] for key in _LISTS)
    shape = (len(psi), len(sigma), len(phi), len(theta))
    factors: dict[str, list[float]] = {}
    values: list[FloatArray] = []

    def block(channel: Channel) -> None:
        one, kbdf = _block(tokens, shape)
        values.append(one)
        if kbdf is not None:
            factors[channel.name] = kbdf.reshape(-1).tolist()

    channels = _channels(tokens, head, block)
    p, i, a, r = (c.reshape(-1) for c in np.meshgrid(psi, sigma, phi, theta, indexing="ij"))
    pole = np.interp(i, sigma, head.lists["sigmaT"]) if "sigmaT" in head.lists else i
    geometry = geo.from_directions(
        directions.vector_from_spherical(i, p), specular.outgoing(pole, p, r, a),
        "about the specular direction", symmetric=len(psi) == 1,
    )  # fmt: skip
    notes = [ABOUT_SPECULAR, *notes]
    if head.words.get("TypeSym", "").startswith(("Axi", "Dir", "Plane")):
        notes.append(f"The file states {head.words['TypeSym']}; only what it holds is in the table.")
    if factors:
        notes.append("Values were multiplied by the kbdf of their incidence.")
    notes.append("The form is that of a transmission file (.ddt) too: nothing in it tells them apart.")
    stacked = np.stack(values, axis=-1)
    reading = Reading(
        NAME, quantity, stacked.reshape(-1, len(channels)), channels, angle_unit="deg",
        filled=trailing_zeros(stacked, -2).reshape(-1),
        symmetry="isotropic" if len(psi) == 1 else "anisotropic",
        provenance={**head.words, "comments": tokens.comments, "kbdf": factors}, notes=tuple(notes),
    )  # fmt: skip
    return [assemble(source, options, reading, geometry)]


FORMAT = Format(NAME, "Integra DDR text, polar about the specular direction", (), sniff, read)


def _head(tokens: Tokens) -> _Head:
    head = _Head()
    while tokens.peek().lower() not in ("wl", "bw", *_CHANNELS):
        key = tokens.word("the first block of values")
        match key.lower():
            case "source":
                head.words["Source"] = tokens.word(key)
            case "typesym":
                head.words["TypeSym"] = tokens.chosen(key, _SYMMETRIES)
                if head.words["TypeSym"] == "ASymmetrical" and tokens.peek() == "4D":
                    head.words["TypeSym"] += " " + tokens.word("4D")
            case "typecolormodel":
                head.words["TypeColorModel"] = tokens.chosen(key, ("rgb", "spectral", "bw"))
                spectral = head.words["TypeColorModel"] == "spectral"
                head.count = (
                    tokens.count(key) if spectral else 3 if head.words["TypeColorModel"] == "rgb" else 1
                )
            case "typedata":
                of = tokens.chosen(key, ("Luminance", "Intensity"))
                head.words["TypeData"] = f"{of} {tokens.chosen(key, ('Absolute', 'Relative'))}"
            case "sigmat":
                sigma = head.lists.get("sigma")
                if sigma is None:
                    raise tokens.error(
                        "sigmaT comes before sigma",
                        "table-header",
                        column="sigmaT",
                        remedy="write sigma first",
                    )
                head.lists["sigmaT"] = tokens.angles(key, 180.0, count=len(sigma))
            case "psi" | "sigma" | "phi" | "theta" as name:
                head.lists[name] = tokens.angles(key, _LISTS[name])
            case _:
                raise tokens.error(
                    f"{key[:40]!r} is no line of an Integra header", "table-header", cause="a damaged header",
                    remedy="begin comments with a semicolon",
                )  # fmt: skip
    return head


def _complete(tokens: Tokens, head: _Head) -> None:
    """Fill in what a DDR header may leave out. TableError for what it may not."""
    head.lists.setdefault("psi", np.zeros(1))
    missing = [key for key in ("sigma", "phi", "theta") if key not in head.lists]
    missing += ["TypeColorModel"] * ("TypeColorModel" not in head.words)
    if missing:
        raise tokens.error(
            f"the header has no {', '.join(missing)}", "table-header", cause="a damaged header",
            remedy="fetch the file again",
        )  # fmt: skip


def _quantity(tokens: Tokens, head: _Head, options: ReadOptions) -> tuple[Quantity, list[str]]:
    stated = head.words.get("TypeData", "")
    if stated.endswith("Relative"):
        raise tokens.error(
            f"TypeData is {stated}: the values have no scale of their own", "table-quantity",
            column="TypeData", cause="kbdf is then the reflectance of an incidence, not a factor",
            remedy="export the file with absolute values, or scale each incidence and write Absolute",
        )  # fmt: skip
    if stated:
        return stated_quantity(options, "ccbrdf" if stated[0] == "I" else "reflectance_factor", stated)
    if options.quantity is None:
        raise tokens.error(
            "the header has no TypeData, so it does not say what its values are", "table-quantity",
            parameter="quantity", remedy=QUANTITY_REMEDY,
        )  # fmt: skip
    return options.quantity, []


def _channels(tokens: Tokens, head: _Head, block: Callable[[Channel], None]) -> list[Channel]:
    """The channels of a file, the block of each read by ``block`` in turn."""
    found: list[Channel] = []
    while tokens.left:
        found.append(_channel(tokens, head, found))
        block(found[-1])
        if tokens.peek().lower() == "enddef":
            tokens.word("enddef")
    if len(found) != head.count:
        raise tokens.truncated(f"the file has {len(found)} channels and should have {head.count}")
    return found


def _specular_only(source: Source, tokens: Tokens, head: _Head, kind: str) -> NoTable:
    """What to tell of an SDR file: the ratio for each channel and incidence, as the file has it."""
    if "TypeColorModel" not in head.words:
        _complete(tokens, head)  # says what is missing
    sigma = head.lists["sigma"]
    values: list[FloatArray] = []

    def block(_: Channel) -> None:
        tokens.chosen("def", ("def",))
        values.append(tokens.numbers(len(sigma), f"specular {kind}"))

    channels = _channels(tokens, head, block)
    told = [
        {
            "name": channel.name, "wavelength_nm": channel.wavelength_nm,
            f"specular_{kind}": [value if math.isfinite(value) else None for value in one.tolist()],
        }
        for channel, one in zip(channels, values, strict=True)
    ]  # fmt: skip
    return source.no_table(
        f"the file holds specular {kind} at {len(sigma)} angles of incidence (SDR): the share that a mirror "
        "direction takes, and no BRDF, which is per steradian", "table-specular-only", f"specular {kind}",
        column="sigma",
        contents={
            "theta_i_deg": np.round(np.rad2deg(sigma), 10).tolist(), "channels": told, **head.words,
            "comments": tokens.comments,
        },
        remedy="fit the .ddr file of the same sample; it holds what is scattered",
    )  # fmt: skip


def _channel(tokens: Tokens, head: _Head, before: list[Channel]) -> Channel:
    model = head.words["TypeColorModel"]
    key = tokens.chosen("a channel", ("wl", "bw", *_CHANNELS))
    if key not in {"spectral": ("wl",), "bw": ("bw",), "rgb": tuple(_CHANNELS)}[model]:
        raise tokens.error(
            f"a block {key} does not belong to color model {model}", "table-header", column=key,
            remedy="correct TypeColorModel",
        )  # fmt: skip
    channel = Channel(_CHANNELS.get(key, "value"))
    if key == "wl":
        nm = float(tokens.numbers(1, "wl")[0])
        if not 0 < nm < 1e6:
            raise tokens.error(
                f"the wavelength is {nm:g} nm", "table-header", column="wl", remedy="write it in nm"
            )
        channel = Channel(f"{nm:g}nm", nm)
    if channel.name in [one.name for one in before]:
        raise tokens.error(
            f"channel {channel.name} is there twice", "table-header", column=key,
            remedy="give each channel one block",
        )  # fmt: skip
    return channel


def _block(tokens: Tokens, shape: tuple[int, int, int, int]) -> tuple[FloatArray, FloatArray | None]:
    """Values (psi, sigma, phi, theta) and the factors (psi, sigma) they were multiplied by."""
    kbdf = None
    if tokens.chosen("kbdf or def", ("kbdf", "def")) == "kbdf":
        kbdf = tokens.numbers(shape[0] * shape[1], "kbdf").reshape(shape[:2])
        tokens.chosen("def", ("def",))
    values = tokens.numbers(math.prod(shape), "BSDF values").reshape(shape)
    if kbdf is not None:
        with np.errstate(over="ignore", invalid="ignore"):
            values = values * kbdf[:, :, None, None]
    return values, kbdf
