"""Parquet: the same columns and statements as delimited text, and what no table of numbers has."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fitter import directions
from fitter.errors import TableError
from fitter.formats import load, load_all, parquet, write
from fitter.table import Table
from tests.formats.samples import delimited_bytes, parquet_bytes


def packed(columns: dict[str, Any], metadata: dict[str, str] | None = None, **options: Any) -> bytes:
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns, metadata=metadata), sink, **options)
    return sink.getvalue().to_pybytes()


ANGLES = {"theta_i_deg": [30.0, 30.0], "theta_o_deg": [30.0, 40.0], "dphi_deg": [180.0, 0.0]}


def test_reads_as_the_same_text():
    ours, text = load(parquet_bytes()), load(delimited_bytes())
    assert ours.hash == text.hash
    assert ours.grid is not None
    assert (ours.metadata.name, ours.metadata.provenance["operator"]) == ("small", "A. B.")
    assert ours.channels[1].wavelength_nm == 550
    peak = int(np.argmax(ours.value[:, 0]))
    assert directions.mirror(ours.wi[peak]) @ ours.wo[peak] > 0.99
    assert not any("line end" in note for note in ours.metadata.notes)


def test_types_of_columns():
    columns = {
        "theta_i_deg": pa.array([30, 30, 30], pa.int8()), "theta_o_deg": pa.array([30, 40, 50], pa.float32()),
        "dphi_deg": pa.array(["a", "b", "a"]).dictionary_encode(), "brdf": pa.array([1.0, None, 3.0]),
        "phi": pa.array([180.0, 180.0, 0.0]).dictionary_encode(), "usable": [True, True, False],
        "who": ["x", "y", None], "nested.name": [{"a": 1}] * 3,
    }  # fmt: skip
    table = load(packed(columns, {"quantity": "brdf"}), columns={"dphi_deg": "ignore", "phi": "dphi_deg"})
    np.testing.assert_array_equal(table.mask, [True, False, False])
    assert table.metadata.masked == {"marked unusable by its source": 1, "missing or not finite": 1}
    assert table.wo[0] @ directions.mirror(table.wi[0]) == pytest.approx(1)
    assert "Columns not used: dphi_deg, who, nested.name." in table.metadata.notes


def test_several_tables():
    columns = {**ANGLES, "brdf": [1.0, 2.0], "wavelength_um": [0.5, 0.6]}
    assert [t.channels[0].wavelength_nm for t in load_all(packed(columns))] == [500.0, 600.0]
    columns = {**ANGLES, "brdf": [1.0, 2.0], "item": pa.array(["a", "b"]).dictionary_encode()}
    assert load(packed(columns), item="b").value.tolist() == [[2.0]]


def test_row_groups_and_conventions():
    angles = {"theta_i_deg": [30.0] * 3, "theta_o_deg": [30.0, 40.0, -30.0], "brdf": [5.0, 1.0, 0.1]}
    data = packed(angles, row_group_size=1)
    forward, back = load(data, convention="forward"), load(data, convention="back")
    np.testing.assert_allclose(forward.wo[0], directions.mirror(forward.wi[0]), atol=1e-15)
    np.testing.assert_allclose(back.wo[0], back.wi[0], atol=1e-15)
    assert load(packed(angles, {"convention": "forward"})).metadata.convention == "forward"


@pytest.mark.parametrize(
    ("columns", "metadata", "code", "column"),
    [
        ({**ANGLES, "value": [1.0, 2.0]}, {}, "table-quantity", None),
        ({**ANGLES, "brdf": ["1.0", "2.0"]}, {}, "table-not-a-number", "brdf"),
        ({**ANGLES, "brdf": [[1.0], [2.0]]}, {}, "table-not-a-number", "brdf"),
        ({"brdf": [1.0, 2.0]}, {}, "table-columns", None),
        ({**ANGLES, "brdf": [1.0, 2.0]}, {"quantity": "btdf"}, "table-header", None),
        ({**ANGLES, "brdf": [1.0, 2.0]}, {"aperture_deg": "wide"}, "table-header", None),
        ({**ANGLES, "brdf": [1.0, 2.0]}, {"notes": "{}"}, "table-header", None),
        ({**ANGLES, "brdf": [1.0, 2.0]}, {"grid": "spherical_isotropic"}, "table-grid", None),
        ({"theta_i_deg": []}, {}, "table-empty", None),
    ],
)
def test_refused(columns: dict[str, Any], metadata: dict[str, str], code: str, column: str | None):
    with pytest.raises(TableError) as caught:
        load(packed(columns, metadata), name="bad.parquet")
    assert (caught.value.code, caught.value.column) == (code, column)
    assert caught.value.file == "bad.parquet"
    assert caught.value.remedy


def test_names_given_twice():
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table([pa.array([1.0]), pa.array([2.0])], names=["brdf", "brdf"]), sink)
    with pytest.raises(TableError) as caught:
        load(sink.getvalue().to_pybytes())
    assert caught.value.column == "brdf"


def test_what_unpacks_without_limit(monkeypatch: pytest.MonkeyPatch):
    """A few bytes can stand for any number of equal rows: it is looked at before they are unpacked."""
    data = packed({name: np.full(2_000_000, 1.0) for name in (*ANGLES, "brdf")})
    assert len(data) < 50_000
    monkeypatch.setattr(parquet, "LARGEST", 1_000_000)
    with pytest.raises(TableError) as caught:
        load(data)
    assert caught.value.code == "table-too-large"


def test_written_files_are_plain_parquet(tmp_path: Path):
    table = load(delimited_bytes())
    assert write(table, tmp_path / "t.parquet", "parquet") == []
    plain = pq.read_table(tmp_path / "t.parquet")
    assert plain.column_names == [
        "theta_i_rad", "theta_o_rad", "dphi_rad", "brdf_per_sr_R", "brdf_per_sr_550nm"
    ]  # fmt: skip
    np.testing.assert_array_equal(plain["brdf_per_sr_R"].to_numpy(), table.value[:, 0])
    assert plain.schema.metadata[b"quantity"] == b"brdf"
    assert load(tmp_path / "t.parquet").grid is not None


def test_odd_channel_names_come_back(tmp_path: Path):
    w = directions.vector_from_spherical(np.deg2rad([10.0, 20.0]), 0.0)
    table = Table(wi=w, wo=directions.mirror(w), value=[[1.0, 2.0]] * 2, channels=["a b", "0.55um"])
    assert write(table, tmp_path / "t", "parquet") == []
    assert load(tmp_path / "t").channels == table.channels


def test_pyarrow_waits_for_such_a_file():
    code = "import sys, fitter.formats as f; f.formats(); sys.exit('pyarrow' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
