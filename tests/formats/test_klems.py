"""WINDOW BSDF XML: directions as Radiance writes them, bases named and declared, plain XML only."""

from __future__ import annotations

import numpy as np
import pytest

from fitter import directions
from fitter.errors import TableError
from fitter.formats import load, load_all
from fitter.formats.klems_basis import KNOWN
from fitter.table import Table
from tests.formats.samples import klems_basis_xml, klems_block_xml, klems_bytes

FULL = (
    (0, 5, 1), (5, 15, 8), (15, 25, 16), (25, 35, 20), (35, 45, 24), (45, 55, 24), (55, 65, 24),
    (65, 75, 16), (75, 90, 12),
)  # fmt: skip


def patches(bands) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """Centres (radians) and projected solid angles of a basis, written out from its definition."""
    rows = []
    for lower, upper, count in bands:
        area = np.pi * (np.sin(np.deg2rad(upper)) ** 2 - np.sin(np.deg2rad(lower)) ** 2) / count
        theta = 0.0 if lower == 0 else (lower + upper) / 2
        rows += [(np.deg2rad(theta), 2 * np.pi * k / count, area) for k in range(count)]
    theta, phi, area = np.array(rows).T
    return theta, phi, area


def lobe(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """An anisotropic lobe about the mirror direction, brighter for light from +x and views from +y."""
    mirror = np.exp(-15 * (1 - (directions.mirror(wi) * wo).sum(axis=-1)))
    return 0.1 + (1 + 0.5 * wi[..., 0] + 0.25 * wo[..., 1]) * mirror


def matrix(side: str) -> np.ndarray:
    """``lobe`` in the file's frame: +z is the back, incident azimuths are those of the light's travel."""
    theta, phi, _ = patches(FULL)
    travel = directions.vector_from_spherical(theta, phi)
    wi, wo = travel * [-1, -1, 1], travel
    if side == "Front":  # from outside the frame is seen in a mirror
        wi, wo = wi * [1, -1, 1], wo * [1, -1, 1]
    return lobe(wi[None, :, :], wo[:, None, :])  # rows are outgoing


def text(values: np.ndarray) -> str:
    return "".join(", ".join(map(repr, row)) + ",\n" for row in values.tolist())


@pytest.mark.parametrize("declared", [True, False])
@pytest.mark.parametrize("side", ["Front", "Back"])
@pytest.mark.parametrize("structure", ["Columns", "Rows"])
def test_values_and_directions(side: str, structure: str, declared: bool):
    values = matrix(side)
    name = "LBNL/Klems Full"
    block = klems_block_xml(
        f"Reflection {side}", text(values if structure == "Columns" else values.T), basis=name
    )
    table = load(klems_bytes([block], klems_basis_xml(FULL, name) if declared else "", structure))
    assert len(table) == 145 * 145
    np.testing.assert_allclose(table.value[:, 0], lobe(table.wi, table.wo), rtol=1e-12)
    assert table.symmetry == "anisotropic"
    at = int(np.argmax(table.value[:, 0] / (1 + 0.5 * table.wi[:, 0] + 0.25 * table.wo[:, 1])))
    np.testing.assert_allclose(table.wo[at], directions.mirror(table.wi[at]), atol=1e-12)


def test_known_bases_cover_the_hemisphere():
    theta, phi, area = patches(FULL)
    full = KNOWN["lbnl/klems full"]
    np.testing.assert_allclose(np.deg2rad(full.theta), theta, atol=1e-15)
    np.testing.assert_allclose(np.deg2rad(full.phi), phi, atol=1e-15)
    assert area.sum() == pytest.approx(np.pi)
    assert [len(basis) for basis in KNOWN.values()] == [145, 77, 41]


def test_other_convention():
    """Files whose incident azimuth is that of the light itself have mirror reflection opposite."""
    table = load(klems_bytes(), convention="phi_specular_180")
    assert table.metadata.convention == "phi_specular_180"
    on_diagonal = table.value[:, 0] >= 3
    np.testing.assert_allclose(table.wi[on_diagonal], table.wo[on_diagonal], atol=1e-12)
    default = load(klems_bytes())
    np.testing.assert_allclose(
        directions.mirror(default.wi[on_diagonal]), default.wo[on_diagonal], atol=1e-12
    )


def test_sides_wavelengths_and_what_is_skipped():
    ones = "1\n" * 121
    back, front = "Reflection Back", "Reflection Front"
    blocks = [
        klems_block_xml(back, ones, "CIE-Z"), klems_block_xml(back, ones, "Visible"),
        klems_block_xml(back, "2 " * 121, "CIE-X"), klems_block_xml("Transmission Back", ones),
        klems_block_xml(front, ones, "Solar"), klems_block_xml(front, ones, "CIE-u"),
        klems_block_xml(front, ones, "550").replace("Integral", "Nanometer"),
    ]  # fmt: skip
    tables = load_all(klems_bytes(blocks))
    assert [t.metadata.provenance["item"] for t in tables] == ["back", "front"]
    assert [c.name for c in tables[0].channels] == ["X", "Y", "Z"]
    assert tables[0].value[0].tolist() == [2, 1, 1]
    assert [(c.name, c.wavelength_nm) for c in tables[1].channels] == [("Solar", None), ("550nm", 550.0)]
    notes = " ".join(tables[1].metadata.notes)
    assert "1 transmission" in notes
    assert "1 blocks hold chromaticities" in notes
    assert load(klems_bytes(blocks), item="front").metadata.name == "made up [front]"


def test_layers_are_items():
    data = klems_bytes().decode()
    layer = data[data.index("<Layer>") : data.index("</Optical>")]
    tables = load_all(data.replace("</Optical>", layer + "</Optical>").encode())
    assert [t.metadata.provenance["item"] for t in tables] == ["layer 1 front", "layer 2 front"]


BOMB = '<!DOCTYPE w [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>'
PLAIN = klems_bytes().decode()
HEAD = '<?xml version="1.0" encoding="UTF-8"?>'
BROKEN = {
    "entities": (PLAIN.replace(HEAD, HEAD + BOMB), "table-xml-doctype"),
    "external": (PLAIN.replace(HEAD, HEAD + '<!DOCTYPE w SYSTEM "file:///etc/passwd">'), "table-xml-doctype"),
    "undefined entity": (PLAIN.replace("nobody", "&nobody;"), "table-xml"),
    "cut": (PLAIN[:-10], "table-xml"),
    "encoding": (PLAIN.replace("UTF-8", "EBCDIC-CP-XX"), "text-encoding"),
    "deep": (PLAIN.replace("nobody", "<a>" * 100 + "</a>" * 100), "table-xml"),
    "many": (PLAIN.replace("nobody", "<a/>" * 200_001), "table-xml"),
    "structure": (PLAIN.replace("Columns", "Diagonals"), "table-header"),
    "direction": (PLAIN.replace("Reflection Front", "Reflection Side"), "table-header"),
    "basis": (PLAIN.replace("AngleBasis>made up", "AngleBasis>another"), "table-header"),
    "patches": (PLAIN.replace("<nPhis>4", "<nPhis>999999999999"), "table-header"),
    "fewer": (PLAIN.replace("<nPhis>4", "<nPhis>3"), "table-truncated"),
    "gap": (PLAIN.replace("<LowerTheta>60", "<LowerTheta>65"), "table-header"),
    "theta": (PLAIN.replace("<Theta>40", "<Theta>75"), "table-header"),
    "number": (PLAIN.replace("3.0", "3.O"), "table-not-a-number"),
    "twice": (klems_bytes([klems_block_xml("Reflection Front", "1 " * 121)] * 2).decode(), "table-header"),
    "transmission": (PLAIN.replace("Reflection", "Transmission"), "table-transmission"),
    "no data": (klems_bytes([]).decode(), "table-empty"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_refused(kind: str):
    data, code = BROKEN[kind]
    with pytest.raises(TableError) as caught:
        load(data.encode(), name="w.xml")
    assert caught.value.code == code
    assert caught.value.remedy
    assert caught.value.file == "w.xml"


def test_white_surface_reflects_all():
    """The sum over projected solid angles of a constant 1/pi is 1 for every incidence."""
    name = "LBNL/Klems Full"
    table: Table = load(
        klems_bytes([klems_block_xml("Reflection Front", "0.3183098861837907 " * 145**2, basis=name)], "")
    )
    area = patches(FULL)[2]
    np.testing.assert_allclose(table.value[:, 0].reshape(145, 145) @ area, 1.0, rtol=1e-12)
