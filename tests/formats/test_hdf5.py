"""HDF5 and NetCDF-4: axes matched or refused, groups as tables, damage that costs neither time nor memory."""

from __future__ import annotations

import time
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter import directions
from fitter.errors import TableError
from fitter.formats import load, load_all
from fitter.formats.hdf5_file import groups_of
from fitter.formats.source import Source
from tests.formats.hdf5_bytes import Var, hdf5
from tests.formats.samples import delimited_bytes, hdf5_bytes

DEG = {"units": "degree"}
FLAT = {
    "theta_i_deg": Var([30.0, 30.0, 30.0, 30.0]), "theta_o_deg": Var([30.0, 40.0, 50.0, 60.0]),
    "dphi": Var([np.pi, np.pi, 0.0, 0.0], (), {"units": "radian"}),
}  # fmt: skip
ONES = Var(np.ones(4))


def test_scales_are_axes():
    ours, text = load(hdf5_bytes()), load(delimited_bytes())
    assert ours.grid is not None
    assert ours.grid.system == "spherical_isotropic"
    np.testing.assert_allclose(ours.wo, text.wo, atol=1e-15)
    # Old files list their datasets by name.
    assert [c.name for c in ours.channels] == ["550nm", "R"]
    np.testing.assert_array_equal(ours.value[:, ::-1], text.value)
    assert ours.metadata.provenance == {"title": "made up"}
    peak = int(np.argmax(ours.value[:, 0]))
    assert directions.mirror(ours.wi[peak]) @ ours.wo[peak] > 0.99


def test_colours_are_in_their_usual_order():
    colours = {f"brdf_{c}": Var(np.full(4, k + 1.0)) for k, c in enumerate("RGB")}
    table = load(hdf5({**FLAT, **colours}))
    assert [c.name for c in table.channels] == ["R", "G", "B"]
    assert table.value[0].tolist() == [1, 2, 3]


def test_packed_and_missing_numbers():
    said = {"scale_factor": 0.5, "add_offset": 1.0, "_FillValue": np.int16(-999)}
    stored = np.array([4, -999, 6, 8], "i2")
    table = load(hdf5({**FLAT, "brdf": Var(stored, (), said)}))
    np.testing.assert_array_equal(table.value[[0, 2, 3], 0], [3.0, 4.0, 5.0])
    assert table.metadata.masked == {"missing or not finite": 1}
    np.testing.assert_allclose(table.wo[0], directions.mirror(table.wi[0]), atol=1e-12)


@given(
    st.lists(st.integers(1, 7), min_size=3, max_size=3), st.lists(st.integers(1, 4), min_size=3, max_size=3),
    st.sampled_from([(), (1,), (2, 1), (3,), (2, 1, 3), (1, 3)]), st.sampled_from(["f8", ">f4", "i4", "u1"]),
)  # fmt: skip
def test_any_chunks_and_filters(shape: list[int], chunks: list[int], filters: tuple[int, ...], kind: str):
    stored = np.arange(np.prod(shape)).reshape(shape).astype(kind) + np.ones(1, kind)
    axes = {"theta_i": 10.0 + np.arange(shape[0]), "theta_o": 20.0 + np.arange(shape[1])}
    axes["dphi"] = 30.0 * np.arange(shape[2])
    variables = {name: Var(nodes, (name,), DEG) for name, nodes in axes.items()}
    variables["brdf"] = Var(
        stored.astype(stored.dtype.newbyteorder("<")), tuple(axes), chunks=tuple(chunks), filters=filters
    )
    np.testing.assert_array_equal(load(hdf5(variables)).value[:, 0], stored.reshape(-1))


def test_parts_never_written_are_missing():
    for kind in ("f8", "i4"):
        brdf = Var(np.arange(4).astype(kind) + 1, chunks=(1,), gaps=1)
        table = load(hdf5({**FLAT, "brdf": brdf}))
        assert table.mask.tolist() == [True, True, True, False]
        assert table.value[:3, 0].tolist() == [1, 2, 3]


def test_items_and_records():
    names = np.array(["red", "grün", "red", "grün"], object)
    named = {**FLAT, "brdf": Var([1.0, 2.0, 3.0, 4.0])}
    assert load(hdf5({**named, "item": Var(names)}), item="grün").value[:, 0].tolist() == [2, 4]
    short = np.array([b"red", b"blue", b"red", b"blue"])
    assert load(hdf5({**named, "item": Var(short)}), item="blue").value[:, 0].tolist() == [2, 4]
    records = np.zeros(4, [(name, "f8") for name in named])
    for name, one in named.items():
        records[name] = np.rad2deg(one.data) if name == "dphi" else one.data
    table = load(hdf5({"data": Var(records)}), columns={"dphi": "dphi_deg"})
    np.testing.assert_allclose(table.wo, load(hdf5(named)).wo, atol=1e-12)
    assert table.value[:, 0].tolist() == [1, 2, 3, 4]


AXES = {"theta_i_deg": [10.0, 30.0], "theta_o_deg": [5.0, 25.0, 45.0], "dphi_deg": [0.0, 180.0]}
VALUES = np.arange(12.0).reshape(2, 3, 2) + 1


class TestAxesWithoutScales:
    def variables(self, **said: Any) -> dict[str, Var]:
        return {**{name: Var(nodes) for name, nodes in AXES.items()}, "brdf": Var(VALUES, (), said)}

    def test_equal_shapes(self):
        mesh = np.meshgrid(*AXES.values(), indexing="ij")
        variables = {name: Var(nodes) for name, nodes in zip(AXES, mesh, strict=True)}
        table = load(hdf5({**variables, "brdf": Var(VALUES)}))
        assert table.grid is not None
        np.testing.assert_array_equal(table.value[:, 0], VALUES.reshape(-1))

    def test_labels(self):
        for said in ({"DIMENSION_LABELS": list(AXES)}, {"axes": ":".join(AXES)}):
            table = load(hdf5(self.variables(**said)))
            assert table.grid is not None
            assert table.grid.shape == (2, 3, 2)
            np.testing.assert_array_equal(table.value[:, 0], VALUES.reshape(-1))
        swapped = ["dphi_deg", "theta_o_deg", "theta_i_deg"]
        table = load(hdf5(self.variables(DIMENSION_LABELS=swapped)))
        np.testing.assert_array_equal(table.value[:, 0], VALUES.transpose(2, 1, 0).reshape(-1))

    def test_lengths(self):
        variables = self.variables()
        variables["dphi_deg"] = Var([0.0, 60.0, 120.0, 180.0])
        variables["brdf"] = Var(np.arange(24.0).reshape(2, 3, 4) + 1)
        np.testing.assert_array_equal(load(hdf5(variables)).value[:, 0], np.arange(24.0) + 1)

    def test_two_axes_of_one_length_are_refused(self):
        with pytest.raises(TableError) as caught:
            load(hdf5(self.variables()), name="bad.h5")
        assert (caught.value.code, caught.value.column) == ("table-columns", "dphi_deg")
        assert "scale" in str(caught.value.remedy)

    def test_what_is_not_asked_for_may_have_any_axes(self):
        variables = self.variables(DIMENSION_LABELS=list(AXES))
        variables |= {"camera": Var(np.zeros((9, 9))), "n": Var(np.zeros(5)), "one": Var(3.0)}
        table = load(hdf5(variables))
        assert len(table) == 12
        assert any("camera" in note for note in table.metadata.notes)


class TestGroups:
    def test_each_with_values_is_a_table(self):
        data = hdf5({
            "theta_i": Var([10.0, 30.0], ("theta_i",), DEG),
            "theta_o": Var([5.0, 25.0, 45.0], ("theta_o",), DEG),
            "dphi": Var(180.0, (), DEG), "info": {"serial": Var([7.0])},
            "red": {"brdf": Var(np.ones((2, 3)), ("theta_i", "theta_o"))},
            "deep": {"blue": {"brdf": Var(2 * np.ones((2, 3)), ("theta_i", "theta_o"))}},
        })  # fmt: skip
        tables = load_all(data)
        assert sorted(t.metadata.provenance["item"] for t in tables) == ["deep/blue", "red"]
        assert load(data, item="deep/blue").value[:, 0].tolist() == [2.0] * 6
        assert len({round(float(z), 6) for z in tables[0].wi[:, 2]}) == 2

    def test_own_axes_come_first(self):
        table = load(hdf5({"dphi_deg": Var([0.0] * 4), "data": {**FLAT, "brdf": ONES}}))
        assert "item" not in table.metadata.provenance
        np.testing.assert_allclose(table.wo[0], directions.mirror(table.wi[0]), atol=1e-12)

    def test_wavelengths_in_groups(self):
        group = {**FLAT, "wavelength": Var([500.0, 500.0, 600.0, 600.0], (), {"units": "nm"}), "brdf": ONES}
        tables = load_all(hdf5({"a": group, "b": group}))
        items = [t.metadata.provenance["item"] for t in tables]
        assert items == ["a 500nm", "a 600nm", "b 500nm", "b 600nm"]
        assert [t.channels[0].wavelength_nm for t in tables] == [500, 600, 500, 600]

    def test_none_with_values(self):
        for tree in ({"a": {"x": ONES}, "b": {"y": ONES}}, {"x": ONES}):
            with pytest.raises(TableError) as caught:
                load(hdf5(tree))
            assert caught.value.code == "table-columns"
        value = {"a": {**FLAT, "x": Var([1.0, 2.0, 3.0, 4.0])}, "b": {"y": ONES}}
        assert load(hdf5(value), columns={"x": "brdf"}).value[:, 0].tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("variables", "attributes", "code"),
    [
        ({**FLAT, "value": ONES}, {}, "table-quantity"),
        ({**FLAT, "brdf": ONES, "sigma": Var([1.0, 2.0])}, {}, "table-columns"),
        ({**FLAT, "brdf": ONES, "phi_i": ONES}, {}, "table-unit"),
        ({**FLAT, "brdf": ONES, "theta_i_deg": Var(np.ones(4), (), {"units": "rad"})}, {}, "table-unit"),
        ({**FLAT, "brdf": Var(np.array([b"a", b"b", b"c", b"d"]))}, {}, "table-not-a-number"),
        ({**FLAT, "brdf": ONES}, {"quantity": "btdf"}, "table-header"),
        ({**FLAT, "brdf": Var(np.ones(4), chunks=(4,), filters=(32000,))}, {}, "table-hdf5-feature"),
        ({}, {}, "table-empty"),
    ],
)  # fmt: skip
def test_refused(variables: dict[str, Any], attributes: dict[str, str], code: str):
    with pytest.raises(TableError) as caught:
        load(hdf5(variables, **attributes), name="bad.h5")
    assert caught.value.code == code
    assert caught.value.file == "bad.h5"
    assert caught.value.remedy


def large(chunks: tuple[int, ...] | None = None) -> bytes:
    """200 kB of noise over a grid."""
    axes = {"theta_i": np.arange(10.0, 30), "theta_o": np.arange(10.0, 35), "dphi": np.arange(0.0, 180, 4)}
    variables = {name: Var(nodes, (name,), DEG) for name, nodes in axes.items()}
    values = np.random.default_rng(1).uniform(1, 2, (20, 25, 45))
    return hdf5({**variables, "brdf": Var(values, tuple(axes), {"history": "x" * 500}, chunks=chunks)})


def swollen(data: bytes, rng: np.random.Generator) -> bytes:
    """Counts, sizes and addresses of the structure replaced by others, large and small."""
    changed = bytearray(data)
    full = np.flatnonzero(np.frombuffer(data, np.uint8, 9000))
    at = int(rng.choice(full)) // 4 * 4
    word = int(rng.choice([2, 4, 8]))
    new = [0, 1, 1 << 40, (1 << 32) - 1, int(rng.integers(len(data))), (1 << 63) + 5, (1 << 31) + 1]
    changed[at : at + word] = (new[int(rng.integers(len(new)))] % (1 << 8 * word)).to_bytes(word, "little")
    return bytes(changed)


@pytest.mark.parametrize("chunks", [None, (10, 25, 9)], ids=["contiguous", "chunked"])
def test_damaged_sizes_cost_neither_time_nor_memory(chunks: tuple[int, ...] | None):
    """Of reading alone: what a table costs beyond its arrays is the same for every format."""
    data, rng, broken = large(chunks), np.random.default_rng(3), 0
    load(data)  # what is imported and cached is no cost of a file
    tracemalloc.start()
    try:
        for _ in range(60):
            changed, start, held = swollen(data, rng), time.process_time(), 0
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            try:
                for group in groups_of(Source(changed)):
                    held += sum(one.read().nbytes for one in group.datasets)
            except TableError:
                broken += 1
            peak = tracemalloc.get_traced_memory()[1] - before
            assert peak < 4 * len(data) + held + (1 << 20)
            assert time.process_time() - start < 5
    finally:
        tracemalloc.stop()
    assert 2 < broken < 60


def test_a_chunk_that_unpacks_without_end():
    """A megabyte of zeros in a kilobyte, where the file says that a chunk has 32 bytes."""
    brdf = Var(np.zeros(1 << 17), chunks=(1 << 17,), filters=(1,))
    data = bytearray(hdf5({**FLAT, "brdf": brdf}))
    size = (1 << 17).to_bytes(8, "little")
    place = data.index(size)
    data[place : place + 8] = (4).to_bytes(8, "little")
    layout = data.index((1 << 17).to_bytes(4, "little") + (8).to_bytes(4, "little"))
    data[layout : layout + 4] = (4).to_bytes(4, "little")
    with pytest.raises(TableError, match="unpacks to more"):
        load(bytes(data))


def test_a_header_that_leads_to_itself():
    """A block of messages whose continuation is the same block again."""
    data = bytearray(hdf5({**FLAT, "brdf": ONES}))
    at = data.index(b"\x11\x00\x10\x00") - 16  # the root's header, before its symbol table message
    assert data[at] == 1
    root = at
    body = bytes(data[at + 16 : at + 16 + int.from_bytes(data[at + 8 : at + 12], "little")])
    loop = len(data)
    again = (0x10).to_bytes(2, "little") + (16).to_bytes(2, "little") + bytes(4)
    data += again + loop.to_bytes(8, "little") + (24).to_bytes(8, "little")
    new = len(data)
    total = len(body) + 24
    data += b"\1\0\xff\xff\1\0\0\0" + total.to_bytes(4, "little") + bytes(4) + body + data[loop : loop + 24]
    data[64:72] = new.to_bytes(8, "little")
    assert root != new
    start = time.process_time()
    with pytest.raises(TableError):
        load(bytes(data))
    assert time.process_time() - start < 5
