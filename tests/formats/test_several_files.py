"""Formats that spread one measurement over several files: CUReT and pab-opto."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fitter import directions
from fitter.errors import NoTable, TableError
from fitter.formats import load, load_all
from tests.formats.samples import curet_files, integra_bytes, pabopto_bytes
from tests.formats.test_contract import mutations


def archive(files: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as content:
        for name, data in files.items():
            content.writestr(name, data)
    return buffer.getvalue()


class TestCuret:
    def test_folder_list_zip_and_beside(self, tmp_path: Path):
        values, geometry = curet_files()
        (tmp_path / "abrdf.dat").write_bytes(values)
        (tmp_path / "table.txt").write_bytes(geometry)
        found = [
            load_all(tmp_path), load_all([values, geometry]), load_all([geometry, values]),
            load_all(archive({"a/table.txt": geometry, "a/abrdf.dat": values})),
            load_all(tmp_path / "abrdf.dat"),
        ]  # fmt: skip
        for tables in found:
            assert [t.metadata.provenance["item"] for t in tables] == ["5", "10"]
            assert [t.hash for t in tables] == [t.hash for t in found[0]]
        table = load(tmp_path, item="10")
        np.testing.assert_allclose(table.wo[0], directions.mirror(table.wi[0]), atol=1e-6)
        np.testing.assert_allclose(table.wo[1], table.wi[1], atol=1e-6)
        # A sample's number is its name, and a name wins over a position.
        assert load(tmp_path, item=10).hash == table.hash
        assert load(tmp_path, item=1).hash == table.hash

    def test_colour_channels(self, tmp_path: Path):
        (tmp_path / "table.txt").write_bytes(curet_files()[1])
        for k, name in enumerate(["rbrdf.dat", "gbrdf.dat", "bbrdf.dat", "abrdf.dat"], start=1):
            (tmp_path / name).write_bytes(curet_files(seed=k)[0])
        tables = load_all(tmp_path)
        assert [[c.name for c in t.channels] for t in tables] == [["R", "G", "B"]] * 2
        expected = [float(curet_files(seed=k)[0].split()[1]) for k in (1, 2, 3)]
        assert tables[0].value[0].tolist() == expected
        assert any("abrdf.dat" in note for note in tables[0].metadata.notes)
        (tmp_path / "gbrdf.dat").write_bytes(curet_files(samples=1)[0])
        with pytest.raises(TableError) as caught:
            load_all(tmp_path)
        assert caught.value.file == "gbrdf.dat"

    def test_one_without_the_other(self):
        values, geometry = curet_files()
        for data, code in ((values, "table-geometry-missing"), (geometry, "table-geometry-only")):
            with pytest.raises(TableError) as caught:
                load_all(data, name="a.dat")
            assert (caught.value.code, caught.value.file) == (code, "a.dat")
            assert caught.value.remedy

    @pytest.mark.parametrize(
        ("part", "old", "new", "row"),
        [
            (0, b"\n10 ", b"\n 5 ", 2), (0, b"\n10 ", b"\nx  ", 2),
            (0, b"\n10     0.140", b"\n10     0.1 4", 2),
            (1, b"    0.900000", b"   90.000000", 3),
        ],
    )  # fmt: skip
    def test_damage(self, part: int, old: bytes, new: bytes, row: int):
        files = list(curet_files())
        assert old in files[part]
        files[part] = files[part].replace(old, new, 1)
        with pytest.raises(TableError) as caught:
            load_all(files)
        assert caught.value.row == row

    def test_fuzz(self):
        values, geometry = curet_files()
        broken = 0
        for k, data in enumerate(mutations(values, 40, seed=5) + mutations(geometry, 40, seed=6)):
            try:
                load_all([data, geometry] if k < 40 else [values, data])
            except TableError:
                broken += 1
        assert 0 < broken < 80


class TestPabOpto:
    def test_one_file(self):
        table = load(pabopto_bytes())
        np.testing.assert_allclose(table.wo[0], directions.mirror(table.wi[0]), atol=1e-12)
        np.testing.assert_allclose(table.wo[1], table.wi[1], atol=1e-12)
        assert table.value[:, 0].tolist() == [2.0, 0.5, 0.25]
        assert any("1 rows are on the other side" in note for note in table.metadata.notes)
        weighted = load(pabopto_bytes(quantity="DSF"))
        assert weighted.metadata.quantity == "ccbrdf"
        np.testing.assert_allclose(weighted.value[2, 0], 0.5)
        assert load(pabopto_bytes(quantity="DSF"), quantity="brdf").value[2, 0] == 0.25

    def test_a_folder_is_one_table(self, tmp_path: Path):
        for theta_i in (10, 30, 50):
            (tmp_path / f"t{theta_i}.txt").write_bytes(pabopto_bytes(theta_i))
        table = load(tmp_path)
        assert (len(table), table.domain.incidences, table.metadata.name) == (9, 3, "s")
        assert table.metadata.provenance["files"] == ["t10.txt", "t30.txt", "t50.txt"]
        (tmp_path / "other.txt").write_bytes(pabopto_bytes(name="other"))
        assert [t.metadata.name for t in load_all(tmp_path)] == ["other", "s"]
        (tmp_path / "other.txt").write_bytes(pabopto_bytes(70, quantity="DSF"))
        with pytest.raises(TableError) as caught:
            load_all(tmp_path)
        assert caught.value.file == "t10.txt"

    def test_folders_in_an_archive_stay_apart(self):
        data = archive(
            {"a/1.txt": pabopto_bytes(10), "a/2.txt": pabopto_bytes(20), "b/1.txt": pabopto_bytes(10)}
        )
        assert [len(t) for t in load_all(data)] == [6, 3]

    def test_back_side(self):
        front, back = load_all([pabopto_bytes(), pabopto_bytes(150)])
        assert back.metadata.provenance["item"] == "back"
        np.testing.assert_allclose(back.wi, front.wi, atol=1e-12)
        # Mirrored: what turns one way seen from the front turns the other way seen from the back.
        np.testing.assert_allclose(back.wo, front.wo * [1, -1, 1], atol=1e-12)

    def test_tristimulus_and_incident_angle(self):
        text = "#incident_angle 82.5 180\n#format: theta phi DSF\n#colorimetry: CIE-XYZ\n"
        text += "60 0 1 2 3\n70 0 1 2 3\n"
        table = load(text.encode())
        assert [c.name for c in table.channels] == ["X", "Y", "Z"]
        np.testing.assert_allclose(table.value[0], [2, 4, 6])
        assert (table.wo[:, 0] > 0).all()
        assert (table.wi[:, 0] < 0).all()

    @pytest.mark.parametrize(
        ("old", "new", "row"),
        [
            (b"theta phi BSDF", b"theta phi R", 6),
            (b"#intheta 30.0", b"#intheta x", 2),
            (b"#intheta 30.0", b"#intheta 300", 2),
            (b"CIE-Y", b"RAL", 5),
            (b"in_file: 4", b"in_file: 5", 11),
            (b"30.0 0.0 0.5", b"30.0 0.0 a", 9),
            (b"30.0 0.0 0.5", b"300 0.0 0.5", 9),
        ],
    )
    def test_damage(self, old: bytes, new: bytes, row: int):
        assert old in pabopto_bytes()
        with pytest.raises(TableError) as caught:
            load(pabopto_bytes().replace(old, new, 1))
        assert caught.value.row == row
        assert caught.value.remedy

    def test_transmission_only(self):
        text = "#intheta 10\n#inphi 0\n#format: theta phi BTDF\n170 180 3\n"
        with pytest.raises(TableError) as caught:
            load(text.encode())
        assert caught.value.code == "table-transmission"


def test_what_holds_no_brdf_is_left_out_beside_tables(tmp_path: Path):
    (tmp_path / "a.ddr").write_bytes(integra_bytes())
    for name in ("b.ddt", "c.ddt"):
        (tmp_path / name).write_bytes(integra_bytes())
    (table,) = load_all(tmp_path)
    assert table.metadata.name == "a"
    told = [note for note in table.metadata.notes if "not read" in note]
    assert told == ["b.ddt holds transmission: not read.", "c.ddt holds transmission: not read."]
    (tmp_path / "a.ddr").unlink()
    with pytest.raises(NoTable) as caught:
        load_all(tmp_path)
    assert caught.value.file == "b.ddt"
