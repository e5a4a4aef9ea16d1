"""UTIA binary: where each number of the file goes, and what tells a file that has no header."""

from __future__ import annotations

import numpy as np
import pytest

from fitter import directions
from fitter.errors import TableError
from fitter.formats import describe, load, load_all
from fitter.formats.utia import SIZE

THETA = np.deg2rad(np.arange(0, 76, 15))
PHI = np.deg2rad(np.arange(0, 360, 7.5))


def lobe(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """An anisotropic lobe about the mirror direction, without any symmetry in azimuth; channels 1 : 2 : 3."""
    mirror = np.exp(-15 * (1 - (directions.mirror(wi) * wo).sum(axis=-1)))
    return np.multiply.outer(0.1 + (1 + 0.5 * wi[..., 0] + 0.25 * wo[..., 1]) * mirror, [1, 2, 3])


def utia_bytes() -> bytes:
    """Row 48 i_theta_i + i_phi_i, column 48 i_theta_v + i_phi_v, one plane after the other."""
    theta, phi = (a.reshape(-1) for a in np.meshgrid(THETA, PHI, indexing="ij"))
    w = directions.vector_from_spherical(theta, phi)
    return np.moveaxis(lobe(w[:, None], w[None, :]), -1, 0).astype("<f8").tobytes()


DATA = utia_bytes()


def test_values_and_directions():
    assert len(DATA) == SIZE == 1_990_656
    table = load(DATA, name="fabric")
    assert (table.metadata.source_format, table.symmetry) == ("utia", "anisotropic")
    assert [c.name for c in table.channels] == ["R", "G", "B"]
    assert table.grid is not None
    assert table.grid.shape == (6, 48, 6, 48)
    np.testing.assert_allclose(table.value, lobe(table.wi, table.wo), rtol=1e-12)
    # The brightest view of a light at 45 deg is its mirror image.
    at = np.flatnonzero((table.wi[:, 2] < 0.71) & (table.wi[:, 2] > 0.70) & (table.wi[:, 0] > 0.70))
    best = at[np.argmax(table.value[at, 0])]
    assert table.wo[best] @ directions.mirror(table.wi[best]) > 0.99
    describe(table)


def test_between_azimuths_over_the_seam():
    table = load(DATA)
    wi = directions.vector_from_spherical(np.deg2rad([30.0]), np.deg2rad([357.0]))
    found, outside = table.evaluate(wi, directions.mirror(wi))
    assert not outside.any()
    np.testing.assert_allclose(found, lobe(wi, directions.mirror(wi)), rtol=0.02)


def test_other_convention_and_quantity():
    plain, turned = load(DATA), load(DATA, convention="phi_specular_0")
    wo = turned.wo * [-1, -1, 1]
    np.testing.assert_allclose(turned.value, lobe(turned.wi, wo), rtol=1e-12)
    weighted = load(DATA, quantity="ccbrdf")
    np.testing.assert_allclose(weighted.value * weighted.wo[:, 2:], plain.value, rtol=1e-12)
    assert any("scale" in note for note in plain.metadata.notes)


def test_negatives_and_missing_are_masked():
    planes = np.frombuffer(DATA, "<f8").copy()
    planes[5], planes[7] = -0.01, np.nan
    table = load(planes.tobytes())
    assert not table.mask[[5, 7]].any()
    assert table.value[5, 0] == -0.01
    assert table.metadata.masked == {"missing or not finite": 1, "negative": 1}


@pytest.mark.parametrize(
    "data",
    [
        bytes(SIZE), np.random.default_rng(1).bytes(SIZE), DATA[:-8], DATA + bytes(8),
        np.frombuffer(DATA, "<f8").astype(">f8").tobytes(),
    ],
    ids=["zeros", "noise", "short", "long", "other byte order"],
)  # fmt: skip
def test_refused(data: bytes):
    with pytest.raises(TableError) as caught:
        load(data, name="x.bin")
    assert caught.value.file == "x.bin"
    assert caught.value.remedy


def test_text_of_that_size_is_text():
    head = b"# quantity: brdf\ntheta_i_deg,theta_o_deg,dphi_deg,brdf\n10,20,0,1\n20,20,0,1\n"
    assert load(head + b"\n" * (SIZE - len(head))).metadata.source_format == "delimited"


def test_damage():
    rng = np.random.default_rng(2)
    for _ in range(20):
        changed = bytearray(DATA)
        for at in rng.integers(0, SIZE, 50):
            changed[at] ^= 1 << int(rng.integers(8))
        for table in load_all(bytes(changed)):
            assert np.isfinite(table.value[table.mask]).all()
