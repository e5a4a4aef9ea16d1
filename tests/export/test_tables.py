"""Models as tables: what a file says is the model as closely as it claims, and what it can't hold is said."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fitter
from fitter import models
from fitter.compression import compress
from fitter.errors import FitterError, SpecError
from fitter.export import subject, table_layout, target, write
from fitter.export.fidelity import compared_pairs
from fitter.export.subject import only
from fitter.formats import rgl_writer
from fitter.formats.source import Source
from fitter.formats.tensor_file import fields
from tests.export.conftest import held_to_the_contract, make

#: Of each format the 95 % quantile of the relative difference from "torrance_sparrow" (alpha 0.15), and what
#: part of the compared directions the file may leave out.
STATED = {
    "merl": (0.01, 0.0), "openexr": (0.03, 0.0), "zemax": (0.05, 0.05), "pab-opto": (0.1, 0.06),
    "mbsdf": (0.01, 0.0),
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", STATED)
def test_a_models_table_is_the_model(name: str, tmp_path: Path) -> None:
    entry = target(name)
    path = tmp_path / f"m{entry.suffix}"
    channels = ["G"] if entry.channels == (1,) else None
    model = make("torrance_sparrow")
    told = write(model, name, path, channels=channels)
    held_to_the_contract(told)
    back = fitter.load(path)
    # A model of fewer channels draws otherwise: its sampler goes by the light in all of them.
    source = subject(model) if channels is None else only(subject(model), channels)
    wi, wo = compared_pairs(source)
    theirs, outside = back.evaluate(wi, wo)
    ours, _ = source.evaluate(wi, wo)
    inside = ~outside
    most, missing = STATED[name]
    change = np.abs(theirs - ours)[inside] / ours[inside]
    assert np.quantile(change, 0.95) < most
    assert outside.mean() <= missing
    (note,) = [note.message for note in told.notes if note.code == "fidelity"]
    stated = re.search(r"by ([\d.]+)% at most", note)
    assert stated is not None
    assert float(stated[1]) / 100 == pytest.approx(np.quantile(change, 0.95), abs=1e-4)


def test_a_lobe_narrower_than_the_format_is_flagged_with_the_number(tmp_path: Path) -> None:
    sharp = models.create("ward", channels=("R", "G", "B"), alpha=0.002, ks=0.5)
    told = write(sharp, "openexr", tmp_path / "m.exr")
    (note,) = [note for note in told.notes if note.code == "too-coarse"]
    assert re.search(r"by [\d.]+% at most", note.message)
    assert "too coarse" in note.message


def test_anisotropic_models_are_refused_where_a_format_is_isotropic(tmp_path: Path) -> None:
    brushed = make("ward:bounded:anisotropic")
    for name in ("merl", "mbsdf", "zemax", "pab-opto"):
        with pytest.raises(SpecError, match="anisotropic"):
            write(brushed, name, tmp_path / "m", channels=["R"])
    assert not list(tmp_path.iterdir())


def test_tables_say_what_was_not_covered(tmp_path: Path) -> None:
    paint = fitter.load(Path(__file__).resolve().parents[2] / "data" / "tables" / "glossy_paint.csv")
    for source in (paint, compress(paint, 0.01)):
        told = write(source, "openexr", tmp_path / "m.exr")
        assert "outside what was measured" in " ".join(note.message for note in told.notes)
    theta = np.deg2rad(np.linspace(-80, 80, 33))
    plane = fitter.Table(
        wi=np.tile([0.5, 0.0, 0.75**0.5], (33, 1)), value=np.full((33, 3), 0.2),
        wo=np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=1),
    )  # fmt: skip
    for name in ("merl", "rgl", "openexr", "lut", "klems", "tensor-tree"):
        with pytest.raises(FitterError, match="plane of incidence"):
            write(
                plane,
                name,
                tmp_path / f"plane{name}",
                channels=["G"] if target(name).channels == (1,) else None,
            )
    assert [path.name for path in tmp_path.iterdir()] == ["m.exr"]


def test_channels_are_chosen_and_counted(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="holds 1, or X, Y, Z channels and this has 3"):
        write(make("ward"), "zemax", tmp_path / "m.bsdf")
    with pytest.raises(SpecError, match="is not there") as refused:
        write(make("ward"), "c", tmp_path / "m.c", channels=["X"])
    assert refused.value.remedy == "the channels are R, G, B"
    write(make("lafortune:2"), "python", tmp_path / "m.py", channels=["B", "R"])
    assert "CHANNELS = ('B', 'R')" in (tmp_path / "m.py").read_text()


def test_a_look_up_texture_is_read_as_its_header_says(tmp_path: Path) -> None:
    """A shader's look-up, written from the layout that stands in the file: nodes, tiles, three blends."""
    import OpenEXR

    model = make("torrance_sparrow")
    write(model, "lut", tmp_path / "m.exr")
    with OpenEXR.File(str(tmp_path / "m.exr"), separate_channels=True) as file:
        planes = [file.channels()[name].pixels for name in "RGB"]
        said = file.header()["comments"]
    assert "phi_d = tile/32 180 deg" in said
    assert "f_r in 1/sr, without the cosine" in said
    picture = np.stack(planes, axis=-1).astype(float)
    wi, wo = (w[::7] for w in compared_pairs(subject(model)))
    h = (wi + wo) / np.linalg.norm(wi + wo, axis=1)[:, None]
    theta_h, theta_d = np.arccos(h[:, 2]), np.arccos((h * wi).sum(axis=1))
    # phi_d between the planes of the normal and of wi about h.
    along = np.cross(np.cross(h, [0.0, 0.0, 1.0]), h)
    across = wi - (h * wi).sum(axis=1)[:, None] * h
    cosine = -(along * across).sum(axis=1) / np.linalg.norm(along, axis=1) / np.linalg.norm(across, axis=1)
    phi_d = np.arccos(np.clip(cosine, -1, 1))
    row = np.sqrt(theta_h / (np.pi / 2)) * 127
    column, tile = theta_d / (np.pi / 2) * 63, phi_d / np.pi * 32
    found = np.zeros((len(wi), 3))
    for a in (0, 1):
        for b in (0, 1):
            for c in (0, 1):
                i, j, k = (np.minimum(x.astype(int), n) + s for x, n, s in
                           ((row, 126, a), (column, 62, b), (tile, 31, c)))  # fmt: skip
                weight = np.prod([1 - np.abs(x - y) for x, y in ((row, i), (column, j), (tile, k))], axis=0)
                found += weight[:, None] * picture[i, k * 64 + j]
    ours = np.asarray(model.evaluate(wi, wo))
    assert np.quantile(np.abs(found - ours) / ours, 0.95) < 0.02


def test_a_table_that_was_an_rgl_file_is_one_again(tmp_path: Path) -> None:
    write(make("oren_nayar"), "rgl", tmp_path / "a.bsdf")
    told = write(fitter.load(tmp_path / "a.bsdf"), "rgl", tmp_path / "b.bsdf")
    assert "exact" in [note.code for note in told.notes]
    one, other = (fields(Source(tmp_path / name)) for name in ("a.bsdf", "b.bsdf"))
    for name in ("theta_i", "phi_i", "ndf", "sigma", "vndf", "rgb", "valid"):
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_incidences_are_as_close_as_a_lobe_takes() -> None:
    """What is expected of a layout is what its file does, at other pairs."""
    paint = subject(fitter.load(Path(__file__).resolve().parents[2] / "data" / "tables" / "glossy_paint.csv"))
    found = table_layout.chosen(paint)
    assert found is not None
    layout, expected = found
    assert 0.003 < expected < 0.007
    assert np.rad2deg(np.diff(layout.theta_i)).max() < 2
    coarse = replace(layout, theta_i=layout.theta_i[::4], steps=64)
    wi, wo = table_layout.table_pairs(paint, 2000, 5)
    ours, _ = paint.evaluate(wi, wo)
    bare = rgl_writer.parameterisation(coarse.theta_i, coarse.phi_i, coarse.alpha, coarse.steps)
    file = replace(bare, data=rgl_writer.sampled(paint.evaluate, 3, bare)[0])
    change = np.abs(file.evaluate(wi, wo) / wo[:, 2:] - ours) / ours
    foretold = table_layout.expected(paint, coarse, wi, wo, ours)
    assert foretold == pytest.approx(np.quantile(change, 0.95), rel=0.01)
    assert foretold > 0.02
