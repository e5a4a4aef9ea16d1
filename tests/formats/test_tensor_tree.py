"""Tensor trees: where each patch lies, what trees of several wavelengths share, and what is no tree."""

from __future__ import annotations

import numpy as np
import pytest

from fitter import directions
from fitter.errors import TableError
from fitter.formats import load, load_all, tensor_tree
from tests.formats.samples import klems_bytes, tensor_tree_bytes


def disk(a: float, b: float) -> tuple[float, float]:
    """Square to disk, written from the four regions of Shirley and Chiu's paper."""
    a, b = 2 * a - 1, 2 * b - 1
    if a > -b:
        r, phi = (a, b / a) if a > b else (b, 2 - a / b)
    elif a < b:
        r, phi = -a, 4 + b / a
    else:
        r, phi = -b, 6 - a / b if b else 0.0
    return r * np.cos(phi * np.pi / 4), r * np.sin(phi * np.pi / 4)


def vector(x: float, y: float) -> np.ndarray:
    return np.array([x, y, np.sqrt(1 - x * x - y * y)])


def lobe(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """An anisotropic lobe about the mirror direction, brighter for light from +x and views from +y."""
    mirror = np.exp(-3 * (1 - (directions.mirror(wi) * wo).sum(axis=-1)))
    return 0.1 + (1 + 0.5 * wi[..., 0] + 0.25 * wo[..., 1]) * mirror


def grid4(side: str, n: int = 4) -> str:
    """A grid of n^4 values of ``lobe`` at the cells' centres, as the file's frame has them."""
    flip = np.array([1, -1, 1]) if side == "Front" else np.ones(3)
    centre = (np.arange(n) + 0.5) / n
    values = [
        float(lobe(vector(*(-c for c in disk(p, q))) * flip, vector(*disk(s, t)) * flip))
        for p in centre for q in centre for s in centre for t in centre
    ]  # fmt: skip
    return "{" + " ".join(map(repr, values)) + "}"


@pytest.mark.parametrize("side", ["Front", "Back"])
def test_directions_and_values_of_four_dimensions(side: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tensor_tree, "_FINE", 2)
    table = load(tensor_tree_bytes([grid4(side)], 4, f"Reflection {side}"))
    assert (len(table), table.symmetry) == (256, "anisotropic")
    np.testing.assert_allclose(table.value[:, 0], lobe(table.wi, table.wo), rtol=1e-12)
    best = int(np.argmax((directions.mirror(table.wi) * table.wo).sum(axis=1)))
    np.testing.assert_allclose(table.wo[best], directions.mirror(table.wi[best]), atol=1e-12)


def test_directions_of_three_dimensions(monkeypatch: pytest.MonkeyPatch):
    """Value k of a 4 x 4 x 4 grid: incidence k // 16, of which the upper half means nothing."""
    monkeypatch.setattr(tensor_tree, "_FINE", 2)
    data = tensor_tree_bytes(["{" + " ".join(map(str, range(1, 65))) + "}"])
    table = load(data)
    assert (len(table), table.symmetry) == (32, "isotropic")
    for k in range(32):
        at = int(np.flatnonzero(table.value[:, 0] == k + 1)[0])
        sine = 1 - 2 * (k // 16 + 0.5) / 4
        np.testing.assert_allclose(table.wi[at], vector(-sine, 0), atol=1e-12)
        outgoing = vector(*disk((k // 4 % 4 + 0.5) / 4, (k % 4 + 0.5) / 4))
        np.testing.assert_allclose(table.wo[at], outgoing, atol=1e-12)


def test_the_square_is_mapped_to_the_disk_and_keeps_areas():
    rng = np.random.default_rng(1)
    square = rng.uniform(0, 1, (200, 2))
    found = tensor_tree.disk_from_square(square)
    np.testing.assert_allclose(found, [disk(*point) for point in square], atol=1e-12)
    even = (np.stack(np.meshgrid(*[np.arange(400)] * 2), axis=-1).reshape(-1, 2) + 0.5) / 400
    radius = np.hypot(*tensor_tree.disk_from_square(even).T)
    for r in (0.25, 0.5, 0.9):
        assert np.mean(radius < r) == pytest.approx(r * r, abs=2e-3)


def test_branches_are_halves():
    """Eight halves that each hold one value are a grid of 2 x 2 x 2, whose axes run the other way."""
    halves = [1 + (n & 1) * 4 + (n >> 1 & 1) * 2 + (n >> 2 & 1) for n in range(8)]
    branched = load(tensor_tree_bytes(["{" + "".join(f"{{{v}}}," for v in halves) + "}"]))
    plain = load(tensor_tree_bytes())
    assert branched.hash == plain.hash


def test_uneven_tree_is_even_where_it_matters():
    """A half that is divided further divides the incidences; its brothers' values hold for all of theirs."""
    fine = "{" + " ".join(map(str, range(10, 18))) + "}"
    table = load(tensor_tree_bytes(["{" + fine + "{2}{3}{4}{5}{6}{7}{8}}"]))
    theta = np.unique(np.round(np.degrees(np.arccos(table.wi[:, 2])), 6))
    np.testing.assert_allclose(theta, np.degrees(np.arcsin([0.25, 0.75])), atol=1e-5)
    # 256 outgoing cells for each of two incidences.
    assert len(table) == 512
    below = (table.wo[:, 0] < 0) & (table.wo[:, 1] < 0) & (np.abs(table.wo[:, 0]) > 0)
    assert set(table.value[:, 0]) == {*range(10, 18), 3, 5, 7}
    assert below.any()


def test_white_surface_reflects_all():
    table = load(tensor_tree_bytes(["{" + repr(1 / np.pi) + "}"] * 3))
    assert [c.name for c in table.channels] == ["X", "Y", "Z"]
    # Patches have equal projected solid angles here.
    np.testing.assert_allclose(np.pi * table.value.mean(axis=0), 1.0, rtol=1e-12)


def test_trees_of_several_wavelengths_share_their_samples():
    coarse, fine = "{7}", "{" + " ".join(map(str, range(1, 9))) + "}"
    table = load(tensor_tree_bytes([coarse, fine, coarse]))
    one = load(tensor_tree_bytes([fine]))
    np.testing.assert_array_equal(table.value[:, 0], one.value[:, 0])
    assert (table.value[:, 1:] == 7).all()


def test_both_sides_are_tables_and_transmission_is_skipped():
    text = tensor_tree_bytes().decode()
    block = text[text.index("<WavelengthData>") : text.index("</Layer>")]
    both = block + block.replace("Back", "Front") + block.replace("Reflection", "Transmission")
    tables = load_all(text.replace(block, both).encode())
    assert [t.metadata.provenance["item"] for t in tables] == ["back", "front"]
    assert all("1 transmission" in t.metadata.notes[0] for t in tables)


def test_values_are_kept_as_they_are():
    table = load(tensor_tree_bytes(["{-1.5 2 nan 4 5 6 7 8}"]))  # -1 would be a fill value
    assert table.metadata.masked == {"missing or not finite": 64, "negative": 64}


DEEP = "{1}"
for _ in range(15):
    DEEP = "{" + DEEP * 8 + "}" if len(DEEP) < 100 else "{" + DEEP + "{1}" * 7 + "}"
BROKEN = {
    "seven values": (["{1 2 3 4 5 6 7}"], 3, "table-header"),
    "another rank": (["{1 2 3 4 5 6 7 8}"], 4, "table-header"),
    "seven halves": (["{" + "{1}" * 7 + "}"], 3, "table-header"),
    "values and halves": (["{1 {2}}"], 3, "table-header"),
    "a brace too many": (["{1}}"], 3, "table-header"),
    "two trees": (["{1}{2}"], 3, "table-header"),
    "cut": (["{{1}{2}"], 3, "table-truncated"),
    "none": ([""], 3, "table-truncated"),
    "a word": (["{one}"], 3, "table-not-a-number"),
    "deep": ([DEEP], 3, "table-header"),
    "rank": (["{1}"], 5, "table-header"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_refused(kind: str):
    trees, rank, code = BROKEN[kind]
    with pytest.raises(TableError) as caught:
        load(tensor_tree_bytes(trees, rank), name="t.xml")
    assert caught.value.code == code
    assert caught.value.file == "t.xml"
    assert caught.value.remedy


def test_a_few_bytes_that_stand_for_billions_of_patches():
    tree = "{1}"
    for _ in range(10):
        tree = "{" + tree + "{1}" * 15 + "}"
    with pytest.raises(TableError) as caught:
        load(tensor_tree_bytes([tree], 4))
    assert caught.value.code == "table-too-large"


def test_a_basis_of_another_kind_is_refused():
    with pytest.raises(TableError) as caught:
        load(tensor_tree_bytes().replace(b"LBNL/Shirley-Chiu", b"LBNL/Klems Full"))
    assert caught.value.column == "AngleBasis"
    with pytest.raises(TableError, match="IncidentDataStructure"):
        load(klems_bytes(structure="Diagonals"))
