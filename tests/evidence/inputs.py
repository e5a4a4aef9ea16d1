"""What is damaged: every measured file that is at hand, and a small file of every format that is read."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from fitter.compression import compress
from fitter.formats import load
from tests.formats.samples import SAMPLES, curet_files
from tests.formats.test_utia import utia_bytes

#: The columns of NIST's table of PTFE.
PTFE_COLUMNS = {
    "lambda": "wavelength_um", "thetai": "theta_i_deg", "phi": "phi_i_deg", "thetar": "theta_o_deg",
    "phir": "phi_o_deg", "f_r11": "brdf",
}  # fmt: skip

#: What a person has to say of a folder's or a file's tables for them to be read.
_OPTIONS: Mapping[str, Mapping[str, Any]] = {
    "mwir": {"convention": "forward"}, "retro-gray-tape.dat": {"quantity": "brdf"},
    "PTFE.data.csv": {"columns": PTFE_COLUMNS},
}  # fmt: skip
_FORMATS = {"mwir": "delimited", "nist_ptfe": "delimited", "cornell": "astm", "curet": "curet",
            "mdl": "mbsdf", "retro": "alta", "rgl": "rgl"}  # fmt: skip
_NO_TABLES = ("README.md", "reference_evaluations.csv")


@dataclass(frozen=True)
class Input:
    """One measurement: its format, its files (name -> bytes), the options it is read with.

    measured : a real file, not one made for the tests.
    """

    name: str
    format: str
    files: Mapping[str, bytes]
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    measured: bool = False

    def sources(self, damaged: str, data: bytes) -> list[BytesIO]:
        """Its files, the one called ``damaged`` replaced by ``data``, open as a reader takes them."""
        found: list[BytesIO] = []
        for name, content in self.files.items():
            file = BytesIO(data if name == damaged else content)
            file.name = name  # what errors call it
            found.append(file)
        return found


@cache
def inputs() -> tuple[Input, ...]:
    """All of them; the measured ones are those of the folder BRDF_SHARED, or of ../shared."""
    return (*_measured(), *_made())


def formats() -> list[str]:
    """The formats there are inputs of."""
    return sorted({one.format for one in inputs()})


def _measured() -> Sequence[Input]:
    default = Path(__file__).resolve().parents[3] / "shared"
    root = Path(os.environ.get("BRDF_SHARED", default)) / "measured"
    found: list[Input] = []
    for path in sorted(root.glob("*/*")):
        folder = path.parent.name
        if path.name in _NO_TABLES or not path.is_file() or (folder == "curet" and path.name != "abrdf.dat"):
            continue
        files = {path.name: path.read_bytes()}
        if folder == "curet":
            files["table.txt"] = path.with_name("table.txt").read_bytes()
        kind = _FORMATS.get(folder, "zemax" if path.suffix == ".bsdf" else "fred")
        options = {**_OPTIONS.get(folder, {}), **_OPTIONS.get(path.name, {})}
        found.append(Input(f"{folder}/{path.name}", kind, files, options, measured=True))
    return found


def _made() -> Sequence[Input]:
    found = [Input(f"made/{s.name}.dat", s.name, {f"{s.name}.dat": s.data}) for s in SAMPLES]
    found.append(Input("made/compressed.dat", "compressed", {"compressed.dat": _compressed()}))
    brdf, geometry = curet_files()
    found.append(Input("made/curet", "curet", {"abrdf.dat": brdf, "table.txt": geometry}))
    found.append(Input("made/utia.bin", "utia", {"utia.bin": utia_bytes()}))
    return found


def _compressed() -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "compressed.dat"
        compress(load(SAMPLES[0].data), 0.01).save(path)
        return path.read_bytes()
