"""Radiance itself takes the BSDF files and finds the reflectance in them."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fitter
from fitter.export import write
from tests.export.conftest import FloatArray, held_to_the_contract, make

#: Angles in degrees. One file a process: Radiance's library keeps what it has read.
_ASK = """
import json, sys
from pyradiance import bsdf
data = bsdf.load_file(sys.argv[1])
thetas = [0.0, 20.0, 45.0, 60.0, 70.0]
hemi = [bsdf.direct_hemi(data, t, 30.0, bsdf.SAMPLE_ALL) for t in thetas]
mirror = [float(bsdf.query(data, t, 30.0, t, 210.0)[0]) for t in thetas]
back = [float(bsdf.query(data, t, 30.0, t, 30.0)[0]) for t in thetas]
print(json.dumps([thetas, hemi, mirror, back]))
"""


def _asked(path: Path) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Incidences, the reflectances that Radiance finds there, f towards the mirror direction and back."""
    done = subprocess.run([sys.executable, "-c", _ASK, path], capture_output=True, text=True, check=True)
    thetas, hemi, mirror, back = (np.array(column) for column in json.loads(done.stdout))
    theta, phi = np.deg2rad(thetas), np.deg2rad(30.0)
    wi = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    return wi, hemi, mirror, back


@pytest.mark.long
@pytest.mark.parametrize(("target", "within"), [("klems", 0.02), ("tensor-tree", 0.01)])
def test_of_a_brushed_surface_radiance_finds_what_the_note_says(
    target: str, within: float, tmp_path: Path
) -> None:
    pytest.importorskip("pyradiance", reason="NO RADIANCE: its reading of exports is not checked")
    model = make("ward:bounded:anisotropic")
    told = write(model, target, tmp_path / "m.xml", channels=["G"])
    (note,) = [note.message for note in told.notes if note.code == "reflectance"]
    stated = re.search(r"by ([\d.]+)% at most", note)
    assert stated is not None
    wi, hemi, _, _ = _asked(tmp_path / "m.xml")
    ours = np.asarray(model.albedo(wi))[:, 1]
    # The note is of two azimuths, this of one of them.
    assert np.abs(hemi / ours - 1).max() < min(float(stated[1]) / 100 + 0.01, within)


@pytest.mark.long
@pytest.mark.parametrize(
    ("target", "name", "most"),
    [("klems", "torrance_sparrow", 0.3), ("tensor-tree", "torrance_sparrow", 0.05)],
)  # fmt: skip
def test_radiance_finds_the_reflectance(target: str, name: str, most: float, tmp_path: Path) -> None:
    pytest.importorskip("pyradiance", reason="NO RADIANCE: its reading of exports is not checked")
    model = make(name)
    path = tmp_path / "m.xml"
    told = write(model, target, path, channels=["G"])
    held_to_the_contract(told)
    assert {"averaged", "reflectance", "reciprocity"} <= {note.code for note in told.notes}
    wi, hemi, mirror, back = _asked(path)
    np.testing.assert_allclose(hemi, np.asarray(model.albedo(wi))[:, 1], rtol=0.02)
    # Directions, too: what it finds towards the mirror and back are ours, as far as patches resolve them.
    ours = np.asarray(model.evaluate(wi, wi * [-1, -1, 1]))[:, 1]
    np.testing.assert_allclose(mirror[:-1], ours[:-1], rtol=most)
    np.testing.assert_allclose(back[1:], np.asarray(model.evaluate(wi, wi))[1:, 1], rtol=0.05)


@pytest.mark.long
def test_a_table_says_what_it_does_not_cover(tmp_path: Path) -> None:
    pytest.importorskip("pyradiance", reason="NO RADIANCE: its reading of exports is not checked")
    table = fitter.load(Path(__file__).resolve().parents[2] / "data" / "tables" / "diffuse_plaster.csv")
    told = write(table, "klems", tmp_path / "m.xml", channels=[table.channels[0].name])
    (note,) = [note for note in told.notes if note.code == "not-covered"]
    assert "% of them lie outside what was measured" in note.message
    assert fitter.load(tmp_path / "m.xml").usable > 10_000
