"""Data frames, Arrow tables and xarray objects: what they mean is what text and NetCDF of them would mean."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from fitter import directions
from fitter.errors import TableError
from fitter.formats import load, load_all
from fitter.grid import Grid
from fitter.metadata import Channel, Metadata
from fitter.table import Table
from tests.formats.samples import SAMPLES, Sample, delimited_bytes, netcdf_bytes

COLUMNS = {
    "theta_i_deg": [30.0, 30.0, 30.0], "theta_o_deg": [30.0, 40.0, 50.0], "dphi_deg": [180.0, 90.0, 0.0],
    "brdf_R": [3.0, 2.0, 1.0], "brdf_550nm": [1.5, 1.0, 0.5],
}  # fmt: skip
FRAMES: dict[str, Callable[[Any], Any]] = {"pandas": pd.DataFrame, "polars": pl.DataFrame, "arrow": pa.table}
frames = pytest.mark.parametrize("frame", list(FRAMES.values()), ids=list(FRAMES))
BACK = {"arrow": Table.to_arrow, "pandas": Table.to_pandas, "xarray": Table.to_xarray}


def as_text(columns: dict[str, Any], head: str = "") -> bytes:
    rows = [",".join(columns), *(",".join(map(str, row)) for row in zip(*columns.values(), strict=True))]
    return (head + "\n".join(rows) + "\n").encode()


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda one: one.name)
def test_every_format_comes_from_bytes_and_open_files(sample: Sample, tmp_path: Path):
    (tmp_path / "a").write_bytes(sample.data)
    wanted = load(tmp_path / "a").hash
    with (tmp_path / "a").open("rb") as file:
        sources = (sample.data, bytearray(sample.data), io.BytesIO(sample.data), file)
        found = [load(source) for source in sources]
    assert [table.hash for table in found] == [wanted] * 4
    after = io.BytesIO(b"junk" + sample.data)
    after.seek(4)
    assert load(after).hash == wanted  # an open file is read from where it stands


@frames
def test_columns_mean_what_they_mean_in_text(frame: Callable[[Any], Any]):
    table, text = load(frame(COLUMNS), name="x"), load(as_text(COLUMNS))
    assert table.hash == text.hash
    assert table.channels == text.channels == (Channel("R"), Channel("550nm", 550.0))
    np.testing.assert_allclose(table.wo[0], directions.mirror(table.wi[0]), atol=1e-15)
    assert (table.metadata.name, table.metadata.source_format, table.metadata.sha256) == ("x", "arrow", "")


@frames
def test_options_hold_for_frames(frame: Callable[[Any], Any]):
    columns = {"a": [30.0, 30.0], "th": [30.0, -30.0], "v": [0.5, 0.25], "who": ["x", "y"]}
    meanings = {"a": "theta_i_deg", "th": "theta_o_deg", "v": "value"}
    options: dict[str, Any] = {"columns": meanings, "quantity": "reflectance_factor", "convention": "back"}
    table = load(frame(columns), **options)
    np.testing.assert_array_equal(table.value[:, 0], np.array([0.5, 0.25]) / np.pi)
    np.testing.assert_allclose(table.wo[0], table.wi[0], atol=1e-15)
    assert "Columns not used: who." in table.metadata.notes
    with pytest.raises(TableError) as caught:
        load(frame(columns), columns=meanings, convention="back")
    assert caught.value.code == "table-quantity"


@frames
def test_items_wavelengths_and_lists(frame: Callable[[Any], Any]):
    columns = {**COLUMNS, "item": ["b", "a", "b"]}
    assert load(frame(columns), item="b").value[:, 0].tolist() == [3.0, 1.0]
    spectral = {**COLUMNS, "wavelength_nm": [500, 600, 600]}
    del spectral["brdf_550nm"]
    found = load_all([frame(spectral), frame(COLUMNS), as_text(COLUMNS)])
    assert [len(table) for table in found] == [1, 2, 3, 3]
    assert found[0].channels[0].wavelength_nm == 500.0


def test_types_of_columns():
    frame = pl.DataFrame({
        **{name: column for name, column in COLUMNS.items() if name != "brdf_R"},
        "brdf_R": pl.Series([3, None, 1], dtype=pl.Int16), "usable": [True, True, False],
        "item": pl.Series(["u", "u", "u"], dtype=pl.Categorical),
    })  # fmt: skip
    table = load(frame)
    np.testing.assert_array_equal(table.mask, [True, False, False])
    assert table.metadata.provenance["item"] == "u"
    labelled = pd.DataFrame(COLUMNS).set_index(["theta_i_deg", "theta_o_deg"])  # an index is columns, too
    assert load(labelled).hash == load(pd.DataFrame(COLUMNS)).hash
    shuffled = pd.DataFrame(COLUMNS).iloc[[2, 0]]  # row labels without a name are nothing
    assert load(shuffled).value[:, 0].tolist() == [1.0, 3.0]
    assert not any("index" in note for note in load(shuffled).metadata.notes)


def test_statements_of_pandas_and_arrow():
    said = {"aperture_deg": 2, "quantity": "ccbrdf", "operator": "A. B.", "symmetry": "anisotropic"}
    columns = {name.replace("brdf", "value"): column for name, column in COLUMNS.items()}
    frame = pd.DataFrame(columns)
    frame.attrs = {**said, "notes": ["one", "two"]}
    metadata = {**{key: str(text) for key, text in said.items()}, "notes": json.dumps(["one", "two"])}
    for table in (load(frame), load(pa.table(columns, metadata=metadata))):
        assert table.symmetry == "anisotropic"
        assert table.metadata.aperture == pytest.approx(np.deg2rad(2))
        assert table.metadata.provenance == {"operator": "A. B."}
        assert table.metadata.notes[:2] == ("one", "two")
        expected = [3, 2, 1] / np.cos(np.deg2rad([30, 40, 50]))
        np.testing.assert_allclose(table.value[:, 0], expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("given_object", "code"),
    [
        (pl.DataFrame(), "table-empty"),
        (pl.DataFrame(COLUMNS).filter(False), "table-empty"),
        (pl.DataFrame({**COLUMNS, "brdf_R": ["a", "b", "c"]}), "table-not-a-number"),
        (pd.DataFrame({**COLUMNS, "brdf_R": pd.Timestamp("2020-01-01")}), "table-not-a-number"),
        (pd.DataFrame({**COLUMNS, "brdf_R": [1, "x", 3.0]}), "table-columns"),
        (pd.DataFrame([[1.0, 2.0]], columns=["brdf", "brdf"]), "table-columns"),
        (pl.DataFrame(COLUMNS)["brdf_R"], "table-columns"),
        (pl.DataFrame(COLUMNS).lazy(), "file-unreadable"),
        (xr.DataArray([1.0]), "table-columns"),
        (xr.Dataset(), "table-empty"),
        (xr.Dataset({"brdf": ("n", np.array(["2020-01-01"], "M8[ns]")), "k": ("n", [1.0])}), "table-columns"),
    ],
)
def test_refused(given_object: Any, code: str):
    with pytest.raises(TableError) as caught:
        load(given_object, name="bad")
    assert caught.value.code == code
    assert caught.value.remedy


def test_datasets_mean_what_netcdf_means(tmp_path: Path):
    (tmp_path / "a.nc").write_bytes(netcdf_bytes())
    with xr.open_dataset(tmp_path / "a.nc", engine="scipy") as dataset:
        table = load(dataset)
    assert table.hash == load(netcdf_bytes()).hash
    assert table.grid is not None
    assert table.metadata.provenance["title"] == "made up"
    np.testing.assert_allclose(load(delimited_bytes()).wo, table.wo, atol=1e-15)


def test_a_data_array_with_a_name():
    deg = {"units": "degrees"}
    coordinates = {
        "theta_i": ("theta_i", [10.0, 30.0], deg), "theta_o": ("theta_o", [10.0, 30.0], deg),
        "dphi": ("dphi", [0.0, 180.0], deg),
    }  # fmt: skip
    array = xr.DataArray(
        np.arange(8.0).reshape(2, 2, 2) + 1, coords=coordinates, dims=("theta_i", "theta_o", "dphi"),
        name="brdf", attrs={"aperture_deg": 3.0, "units": "sr-1"},
    )  # fmt: skip
    table = load(array)
    assert table.grid is not None
    assert table.value[:, 0].tolist() == list(range(1, 9))
    assert table.metadata.aperture == pytest.approx(np.deg2rad(3))
    mixed = array.transpose("dphi", "theta_i", "theta_o")
    assert load(mixed).hash == table.hash
    named = xr.Dataset({"brdf": array.isel(dphi=1), "item": ("theta_i", ["a", "b"])})
    assert load(named, item="b").value[:, 0].tolist() == [6.0, 8.0]


CHANNELS: list[list[str | Channel] | None] = [
    None, ["R", "G", "B"], [Channel("550nm", 550.0)], ["grün [%]", "a_b", "7"],
]  # fmt: skip


@dataclass(frozen=True)
class Recipe:
    """What a random table is made from."""

    seed: int
    gridded: bool
    count: int
    channels: list[str | Channel] | None
    with_sigma: bool
    symmetry: Literal["isotropic", "anisotropic"]
    name: str
    aperture: float | None

    def table(self) -> Table:
        """A grid or a scattered table, with all that a table may say of itself."""
        rng = np.random.default_rng(self.seed)
        count = 12 if self.gridded else self.count
        where: dict[str, Any] = {
            name: directions.vector_from_spherical(rng.uniform(0, 1.5, count), rng.uniform(-3, 3, count))
            for name in ("wi", "wo")
        }  # fmt: skip
        if self.gridded:
            sizes = {"theta_i": 2, "theta_o": 3, "dphi": 2}
            axes = {name: np.sort(rng.uniform(0, 1.4, n)) for name, n in sizes.items()}
            where = {"grid": Grid("spherical_isotropic", axes, {"dphi": 2 * np.pi})}
        value = rng.lognormal(size=(count, 1 if self.channels is None else len(self.channels)))
        value[rng.random(count) < 0.1] *= -1
        value[rng.random(count) < 0.1] = np.nan
        value[0] = 1.0
        usable = rng.random(count) < 0.8
        usable[0] = True
        stated = Metadata(
            name=self.name, aperture=self.aperture, scale_uncertainty=0.01,
            provenance={"who": "A", "n": [1, 2]}, notes=("one", "two"),
        )  # fmt: skip
        return Table(
            **where, value=value, channels=self.channels, metadata=stated, mask=usable,
            sigma=np.abs(value) * 0.1 + 1e-3 if self.with_sigma else None,
            symmetry=None if self.gridded else self.symmetry,
        )  # fmt: skip


recipes = st.builds(
    Recipe, seed=st.integers(0, 2**32 - 1), gridded=st.booleans(), count=st.integers(1, 20),
    channels=st.sampled_from(CHANNELS), with_sigma=st.booleans(),
    symmetry=st.sampled_from(["isotropic", "anisotropic"]), name=st.sampled_from(["", "a table"]),
    aperture=st.sampled_from([None, 0.1]),
)  # fmt: skip


@given(recipes, st.sampled_from(["arrow", "pandas", "xarray"]))
def test_there_and_back_is_exact(recipe: Recipe, kind: str):
    table = recipe.table()
    back = load(BACK[kind](table))
    assert back.hash == table.hash
    assert (back.symmetry, back.channels) == (table.symmetry, table.channels)
    for name in ("aperture", "scale_uncertainty", "angle_uncertainty"):
        assert getattr(back.metadata, name) == getattr(table.metadata, name)
    assert dict(back.metadata.provenance) == dict(table.metadata.provenance)
    assert set(table.metadata.notes) <= set(back.metadata.notes)
    assert sum(back.metadata.masked.values()) == sum(table.metadata.masked.values())
    if table.grid is not None:
        assert back.grid is not None
        assert dict(back.grid.periodic) == dict(table.grid.periodic)


@given(recipes)
def test_polars_keeps_the_numbers(recipe: Recipe):
    """It has no place for statements: every number comes back, what they are called may not."""
    table = recipe.table()
    back = load(table.to_polars())
    order = np.lexsort(back.wo.T), np.lexsort(table.wo.T)
    for name in ("wi", "wo", "value", "mask"):
        np.testing.assert_array_equal(getattr(back, name)[order[0]], getattr(table, name)[order[1]])
    assert (back.sigma is None) == (table.sigma is None)


def test_a_table_offers_its_columns():
    table = load(delimited_bytes())
    for frame in (pl.DataFrame(table), pa.table(table), pd.DataFrame.from_arrow(table)):
        assert load(frame).hash == table.hash


def test_grids_become_coordinates():
    dataset = load(delimited_bytes()).to_xarray()
    assert dict(dataset.sizes) == {"theta_i_rad": 3, "theta_o_rad": 4, "dphi_rad": 3}
    assert set(dataset.coords) == set(dataset.sizes)
    assert dataset["brdf_per_sr_R"].attrs["units"] == "sr-1"
    chosen = dataset["brdf_per_sr_R"].sel(dphi_rad=np.pi, theta_i_rad=np.deg2rad(30), method="nearest")
    assert float(chosen.max()) == 1.3


@pytest.mark.parametrize("name", ["pandas", "polars", "xarray"])
def test_nothing_of_others_is_imported_unasked(name: str, tmp_path: Path):
    """None of the three is imported by what doesn't need it; where one is missing it is named."""
    (tmp_path / "t.csv").write_bytes(delimited_bytes())
    code = f"""if True:
        import sys
        import fitter
        table = fitter.load(sys.argv[1])
        assert not {{"pandas", "polars", "xarray"}} & set(sys.modules)
        sys.modules[{name!r}] = None
        try:
            table.to_{name}()
        except fitter.TableError as error:
            print(error.code, error.remedy)
    """
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "t.csv")], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"package-missing pip install {name}\n"
