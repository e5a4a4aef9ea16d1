"""Every format: found by content, from any kind of source; bad bytes are typed errors."""

from __future__ import annotations

import io
import subprocess
import sys
import warnings
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from fitter import directions
from fitter.errors import FitterError, SpecError, TableError
from fitter.formats import describe, formats, load, load_all, read_options
from fitter.table import Table
from tests.formats.samples import SAMPLES, Sample

each = pytest.mark.parametrize("sample", SAMPLES, ids=lambda s: s.name)


def test_every_registered_format_has_a_sample():
    # The project's own compressed form has no independent writer: tests/compression has its tests.
    # CUReT's is two files: test_several_files has its tests. UTIA's is always 2 MB: test_utia has.
    assert {f.name for f in formats()} - {"compressed", "curet", "utia"} == {s.name for s in SAMPLES}


def test_no_jax():
    code = "import sys, fitter.formats; sys.exit('jax' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@each
def test_content_decides(sample: Sample, tmp_path: Path):
    path = tmp_path / "picture.png"
    path.write_bytes(sample.data)
    with path.open("rb") as file:
        tables = [load(path), load(str(path)), load(sample.data, name="picture"), load(file)]
    tables.append(load(io.BytesIO(sample.data)))
    for table in tables:
        assert table.metadata.source_format == sample.name
        assert len(table) == sample.samples
        assert table.hash == tables[0].hash
        assert len(table.metadata.sha256) == 64
        assert (np.abs(np.linalg.norm(table.wi, axis=1) - 1) < 1e-9).all()


@each
def test_describe_is_json(sample: Sample):
    import json

    document = describe(load(sample.data))
    json.dumps(document, allow_nan=False)
    assert document["usable"] + sum(document["masked"].values()) == document["samples"]
    # Those of cells, trees of patches and vectors are nobody's unit.
    without = ("merl", "mbsdf", "tensor-tree")
    assert document["angle_unit"] in (("",) if sample.name in without else ("deg", "rad"))


def test_describe_incidences_between_two_degrees():
    for theta_i in np.deg2rad(np.arange(2.5, 89)):
        wi = directions.vector_from_spherical(np.full(2, theta_i), [0.0, np.pi])
        peaks = describe(Table(wi=wi, wo=directions.mirror(wi), value=[1.0, 2.0]))["peaks"]
        assert peaks[0]["specular_side"]["theta_o_deg"] == pytest.approx(np.rad2deg(theta_i))


@each
def test_grid_is_found(sample: Sample):
    table = load(sample.data)
    if not sample.gridded:
        return
    assert table.grid is not None
    wi, wo = table.grid.directions()
    np.testing.assert_allclose(table.wi, wi)
    np.testing.assert_allclose(table.wo, wo)


@each
def test_name_option(sample: Sample):
    assert load(sample.data, name="mine").metadata.name == "mine"


@each
@pytest.mark.parametrize("share", [0.02, 0.3, 0.5, 0.9, 0.985])
def test_truncated(sample: Sample, share: float):
    cut = sample.data[: int(len(sample.data) * share)]
    # Of a file that states no count, a cut between numbers can't be seen.
    with pytest.raises(TableError) if sample.counted else suppress(TableError) as caught:
        load(cut, name="cut.dat")
    if caught is not None:
        assert caught.value.remedy
        assert caught.value.file == "cut.dat"


JUNK = {
    "empty": b"",
    "blank": b" \n\n \t\n",
    "html": b"\n<!DOCTYPE html>\n<html><body>Sign in</body></html>",
    "zeros": bytes(5000),
    "noise": np.random.default_rng(1).bytes(5000),
    "utf16": "theta_i_deg,theta_o_deg,brdf\n1,2,3\n".encode("utf-16"),
    "utf16 bare": "theta_i_deg,theta_o_deg,brdf\n1,2,3\n".encode("utf-16-le"),
    "nul": b"theta_i_deg,theta_o_deg,dphi_deg,brdf\n10,20,0,1\n10,30,\x00,1\n" + b"10,40,0,1\n" * 50,
    "latin-1": b"# mesur\xe9\ntheta_i_deg,theta_o_deg,dphi_deg,brdf\n10,20,0,1\n",
    "rgl": b"tensor_file\0\1\0" + bytes(100),
    "json": b'{"a": [1, 2, 3]}',
    "xml": b'<?xml version="1.0"?><a/>',
    "png": b"\x89PNG\r\n\x1a\n" + bytes(50),
    "prose": b"To whom it may concern,\nthe table is in the other file.\n",
    "one word": b"hello",
    "header only": b"theta_i_deg,theta_o_deg,dphi_deg,brdf\n",
    "comments only": b"# nothing\n# here\n",
    "merl 2 GB": np.array([450, 450, 450], "<i4").tobytes() + bytes(3000),
    "merl huge": np.array([99_999, 99_999, 99_999], "<i4").tobytes() + bytes(3000),
    "merl negative": np.array([-90, 90, 180], "<i4").tobytes() + bytes(3000),
    "astm huge": b"NUM_POINTS 2000000000\nVARS theta_i,phi_i,theta_s,phi_s,R\n\n0.1,0,0.1,3.14,1\n",
    "alta huge": b"#DIM 999 999\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n#PARAM_OUT INV_STERADIAN\n0 0 0 1\n",
    "zip damaged": b"PK\x03\x04" + bytes(200),
}


@pytest.mark.parametrize("kind", JUNK)
def test_junk(kind: str):
    with pytest.raises(TableError) as caught:
        load(JUNK[kind], name="junk.dat")
    error = caught.value
    assert error.file == "junk.dat"
    assert error.remedy
    assert error.code
    if kind == "html":
        assert "HTML" in error.message
    if kind == "nul":
        assert error.row == 3
    if kind == "latin-1":
        assert error.row == 1


def mutations(data: bytes, count: int, seed: int) -> list[bytes]:
    rng = np.random.default_rng(seed)
    made: list[bytes] = []
    for k in range(count):
        changed = bytearray(data)
        # Half of the damage goes to the head, where the structure is.
        reach = len(data) if k % 2 else min(len(data), 200)
        match k % 5:
            case 0 | 1:
                for at in rng.integers(0, reach, rng.integers(1, 6)):
                    changed[at] ^= 1 << int(rng.integers(8))
            case 2:
                del changed[int(rng.integers(len(data))) :]
            case 3:
                a, b = sorted(rng.integers(0, len(data), 2).tolist())
                changed[a:a] = changed[a:b]
            case _:
                a = int(rng.integers(0, reach))
                word = [b"nan", b"1e999", b"-", b",,", b"\n", b" 9e9 ", b"\xff", b"inf", b"#", b'"', b"-7"]
                changed[a : a + 2] = word[int(rng.integers(len(word)))]
        made.append(bytes(changed))
    return made


@pytest.mark.long
@each
def test_fuzz(sample: Sample):
    """Damage gives a TableError with a remedy or a table; no other exception, no warning."""
    good = 0
    broken: list[TableError] = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for data in mutations(sample.data, 400, seed=7):
            try:
                tables = load_all(data, name="fuzz.dat")
            except TableError as error:
                broken.append(error)
                continue
            for table in tables:
                assert isinstance(table, Table)
                assert np.isfinite(table.value[table.mask]).all()
                describe(table)
            good += 1
    assert good
    assert broken
    assert all(error.code and error.file == "fuzz.dat" and str(error) for error in broken)
    # Where in the file, too, unless it is all of it.
    unplaced = {error.code for error in broken if set(error.where()) == {"file"}}
    assert unplaced <= {"table-empty", "table-nothing-usable"}
    # A piece that was doubled makes the file twice as long at most.
    assert all(0 <= error.offset <= 2 * len(sample.data) for error in broken if error.offset is not None)


class TestSeveral:
    def write(self, folder: Path) -> Path:
        for k, sample in enumerate(SAMPLES):
            (folder / f"{k:02d}.dat").write_bytes(sample.data)
        (folder / ".hidden").write_bytes(b"")
        return folder

    def test_folder_list_zip(self, tmp_path: Path):
        folder = self.write(tmp_path)
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w") as content:
            for path in sorted(folder.glob("*.dat")):
                content.write(path, f"inner/{path.name}")
        found = [load_all(folder), load_all(sorted(folder.glob("*.dat"))), load_all(archive.getvalue())]
        for tables in found:
            assert [t.metadata.source_format for t in tables] == [s.name for s in SAMPLES]
        assert load_all(folder, item="02.dat")[0].metadata.source_format == "merl"
        with pytest.raises(TableError, match=f"holds {len(SAMPLES)} tables"):
            load(folder)
        assert load(folder, item=1).metadata.source_format == "astm"
        with pytest.raises(SpecError):
            load(folder, item="nothing")

    def test_a_file_that_is_no_table_is_named(self, tmp_path: Path):
        folder = self.write(tmp_path)
        (folder / "README.html").write_text("<html></html>")
        with pytest.raises(TableError) as caught:
            load_all(folder)
        assert caught.value.file == "README.html"

    def test_empty_folder(self, tmp_path: Path):
        with pytest.raises(TableError, match="no file"):
            load_all(tmp_path)

    def test_zip_that_claims_too_much(self):
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w") as content:
            content.writestr("a.csv", b"x")
        data = bytearray(archive.getvalue())
        at = data.index(b"PK\x01\x02") + 24  # uncompressed size in the directory
        data[at : at + 4] = (0x7FFFFFFF).to_bytes(4, "little")
        with pytest.raises(TableError, match="claims"):
            load_all(bytes(data))

    def test_zip_fuzz(self):
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as content:
            content.writestr("a.csv", SAMPLES[0].data)
        for data in mutations(archive.getvalue(), 200, seed=3):
            try:
                load_all(data, name="fuzz.zip")
            except FitterError as error:
                str(error)


class TestSource:
    def test_missing(self, tmp_path: Path):
        with pytest.raises(TableError) as caught:
            load(tmp_path / "nothing.csv")
        assert caught.value.code == "file-missing"
        assert caught.value.file == "nothing.csv"

    def test_open_as_text(self):
        with pytest.raises(TableError, match="open as text"):
            load(io.StringIO("a"))  # type: ignore[arg-type]

    def test_not_a_source(self):
        with pytest.raises(TableError, match="int"):
            load(3)  # type: ignore[arg-type]


class TestOptions:
    def test_round_trip(self):
        given = {"quantity": "ccbrdf", "columns": {"a": "theta_i_deg", "3": "brdf"}, "item": 2}
        options = read_options(given)
        assert options.to_dict() == given
        assert read_options(options.to_dict()) == options
        assert hash(options) == hash(read_options(given))
        assert read_options({}).to_dict() == {}

    @pytest.mark.parametrize(
        "bad",
        [
            {"colums": {}}, {"quantity": "btdf"}, {"quantity": []}, {"convention": "left"},
            {"negatives": "clamp"},
            {"item": True}, {"item": [1]}, {"name": 5}, {"columns": 3}, {"columns": {"a": 3}},
            {"columns": [["a"]]}, {"columns": (("a", "brdf"), 4)},
        ],
    )  # fmt: skip
    def test_bad(self, bad: dict[str, object]):
        with pytest.raises(SpecError) as caught:
            read_options(bad)
        assert caught.value.parameter == next(iter(bad))

    @each
    def test_convention_of_another_format(self, sample: Sample):
        with pytest.raises(TableError) as caught:
            load(sample.data, convention="phi_specular_0" if sample.name == "merl" else "center")
        assert caught.value.parameter == "convention"
