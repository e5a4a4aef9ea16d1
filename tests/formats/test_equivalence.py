"""One measurement written in every way that files have: the same table, and the same fit of it.

The texts are written here, not by the project's writers; those are held to the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fitter
from fitter import directions
from fitter.formats import formats, load, load_all, rgl_writer, specular, write
from fitter.formats.mbsdf import mbsdf_grid
from fitter.formats.merl import merl_grid
from fitter.grid import Grid
from fitter.metadata import Channel, Metadata
from fitter.table import Table

#: Two fits of tables that differ by rounding of the last digit.
SAME_FIT = 1e-9
CHANNELS = ["X", "Y", "Z"]

THETA_I = np.deg2rad([5.0, 25.0, 45.0, 65.0])
THETA_O = np.deg2rad(np.arange(4.0, 81, 6.0))
DPHI = np.deg2rad(np.arange(0.0, 181, 12.0))


def reflectance(wi: np.ndarray, wo: np.ndarray, noise: float = 0.03, seed: int = 1) -> np.ndarray:
    """A diffuse surface with a lobe, three channels, relative noise."""
    h = wi + wo
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    lobe = np.exp(-(np.tan(np.arccos(np.clip(h[:, 2], 0, 1))) ** 2) / 0.2**2)
    lobe /= np.sqrt(np.maximum(wi[:, 2] * wo[:, 2], 1e-3))
    value = np.array([0.03, 0.06, 0.1]) + np.outer(lobe, [0.4, 0.5, 0.6])
    return value * (1 + noise * np.random.default_rng(seed).standard_normal(value.shape))


def made(grid: Grid) -> Table:
    return Table(grid=grid, value=reflectance(*grid.directions()), channels=CHANNELS)


@pytest.fixture(scope="module")
def base() -> Table:
    axes = {"theta_i": THETA_I, "theta_o": THETA_O, "dphi": DPHI}
    return made(Grid("spherical_isotropic", axes))


def fitted(table: Table) -> dict[str, np.ndarray]:
    # Every sample alike: by default those of a grid count by their solid angles, and those of vectors do not.
    found = fitter.fit(table, "ward", weighting="samples")
    return {name: np.asarray(e.value) for name, e in found.parameters.items()}


@pytest.fixture(scope="module")
def best(base: Table) -> dict[str, np.ndarray]:
    return fitted(base)


def apart(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> float:
    """Largest relative difference of two fits' parameters."""
    return max(float((np.abs(one[name] - other[name]) / np.abs(one[name])).max()) for name in one)


def angles(table: Table) -> dict[str, np.ndarray]:
    wi, wo = table.wi, table.wo
    theta_i, phi_i = directions.spherical_from_vector(wi)
    theta_o, phi_o = directions.spherical_from_vector(wo)
    return {"theta_i": theta_i, "phi_i": phi_i, "theta_o": theta_o, "phi_o": phi_o}


def held(table: Table, quantity: str) -> np.ndarray:
    """Values as a file of that quantity has them."""
    if quantity == "ccbrdf":
        return table.value * table.wo[:, 2:]
    return table.value * (np.pi if quantity == "reflectance_factor" else 1.0)


def rows(*columns: np.ndarray, separator: str = ",") -> str:
    listed = zip(*(column.tolist() for column in columns), strict=True)
    return "\n".join(separator.join(map(repr, row)) for row in listed) + "\n"


def delimited(table: Table, quantity: str, unit: str, convention: str) -> bytes:
    a = angles(table)
    a["phi_o"] = a["phi_o"] - (np.pi if convention == "phi_specular_0" else 0.0)
    columns = {name: np.rad2deg(one) if unit == "deg" else one for name, one in a.items()}
    names = [*(f"{name}_{unit}" for name in columns), *(f"{quantity}_{c.name}" for c in table.channels)]
    head = f"# quantity: {quantity}\n# convention: {convention}\n" + ",".join(names) + "\n"
    return (head + rows(*columns.values(), *held(table, quantity).T)).encode()


@pytest.mark.parametrize("convention", ["phi_specular_180", "phi_specular_0"])
@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("quantity", ["brdf", "ccbrdf", "reflectance_factor"])
def test_quantities_units_and_azimuths(
    base: Table, best: dict[str, np.ndarray], quantity: str, unit: str, convention: str
):
    data = delimited(base, quantity, unit, convention)
    table = load(data)
    assert (table.metadata.quantity, table.metadata.convention) == (quantity, convention)
    np.testing.assert_allclose(table.value, base.value, rtol=1e-14)
    assert apart(best, fitted(table)) < SAME_FIT


def test_turned_to_another_azimuth(base: Table, best: dict[str, np.ndarray]):
    """An isotropic surface whose light comes from 70 degrees: the same surface."""
    a = angles(base)
    head = "# quantity: brdf\n# symmetry: isotropic\ntheta_i_rad,phi_i_rad,theta_o_rad,phi_o_rad,"
    head += ",".join(f"brdf_{c}" for c in CHANNELS) + "\n"
    turn = np.deg2rad(70.0)
    columns = a["theta_i"], a["phi_i"] + turn, a["theta_o"], a["phi_o"] + turn
    table = load((head + rows(*columns, *base.value.T)).encode())
    assert table.symmetry == "isotropic"
    assert apart(best, fitted(table)) < SAME_FIT


def test_half_difference_angles_and_vectors(base: Table, best: dict[str, np.ndarray]):
    h, phi_h, d, phi_d = directions.half_difference_from_vectors(base.wi, base.wo)
    names = ",".join(f"brdf_{c}" for c in CHANNELS)
    half = "theta_h_rad,phi_h_rad,theta_d_rad,phi_d_rad," + names + "\n"
    half += rows(h, phi_h, d, phi_d, *base.value.T)
    vectors = "wi_x,wi_y,wi_z,wo_x,wo_y,wo_z," + names + "\n" + rows(*base.wi.T, *base.wo.T, *base.value.T)
    for text in (half, vectors):
        table = load(f"# quantity: brdf\n{text}".encode())
        np.testing.assert_allclose(table.wi, base.wi, atol=1e-12)
        np.testing.assert_allclose(table.wo, base.wo, atol=1e-12)
        assert apart(best, fitted(table)) < SAME_FIT


def test_in_plane_conventions():
    """The same in-plane scan with signed angles, forward or back, and with azimuths."""
    theta_i, theta_o = (
        c.reshape(-1) for c in np.meshgrid(
            THETA_I, np.deg2rad(np.arange(-78.0, 79, 6)), indexing="ij"
        )
    )  # fmt: skip
    # theta_o > 0 is the specular side.
    wi, wo = directions.vector_from_spherical(theta_i, 0.0), directions.vector_from_spherical(theta_o, np.pi)
    value = reflectance(wi, wo)
    names = ",".join(f"brdf_{c}" for c in CHANNELS)
    head = "# quantity: brdf\ntheta_i_rad,theta_o_rad," + names + "\n"
    forward = load((head + rows(theta_i, theta_o, *value.T)).encode(), convention="forward")
    back = load((head + rows(theta_i, -theta_o, *value.T)).encode(), convention="back")
    dphi = np.where(theta_o >= 0, np.pi, 0.0)
    head = head.replace("theta_o_rad", "theta_o_rad,dphi_rad")
    azimuths = load((head + rows(theta_i, np.abs(theta_o), dphi, *value.T)).encode())
    expected = fitted(Table(wi=wi, wo=wo, value=value, channels=CHANNELS))
    for table in (forward, back, azimuths):
        assert table.domain.in_plane
        assert apart(expected, fitted(table)) < SAME_FIT


def fred(base: Table, unit: str) -> bytes:
    a = {name: np.rad2deg(one) if unit == "deg" else one for name, one in angles(base).items()}
    half = 180.0 if unit == "deg" else np.pi
    lines = ["type bsdf_data", f"format angles={unit} bsdf=value scale=2"]
    for theta_i in np.unique(a["theta_i"]):
        here = a["theta_i"] == theta_i
        lines.append(f"{float(theta_i)!r} 0")
        block = rows(a["theta_o"][here], a["phi_o"][here] - half, base.value[here, 0] / 2, separator=" ")
        lines.append(block.rstrip())
    return ("\n".join(lines) + "\n").encode()


def astm(base: Table, quantity: str) -> bytes:
    name = {"brdf": "BRDF", "ccbrdf": "CCBRDF", "reflectance_factor": "REFLECTANCE_FACTOR"}[quantity]
    head = f"MEAS_NAME {name}\nNUM_POINTS {len(base)}\nVARS theta_i,phi_i,theta_s,phi_s,Y\n\n"
    return (head + rows(*angles(base).values(), held(base, quantity)[:, 0])).encode()


def alta(base: Table, quantity: str, how: str) -> bytes:
    a = angles(base)
    dphi = a["phi_o"] - a["phi_i"]
    columns = {
        "ISOTROPIC_TL_TV_DPHI": (a["theta_i"], a["theta_o"], dphi),
        "ISOTROPIC_TV_TL_DPHI": (a["theta_o"], a["theta_i"], dphi),
        "ISOTROPIC_TL_TV_PROJ_DPHI": (
            a["theta_i"], a["theta_o"] * np.cos(dphi), a["theta_o"] * np.sin(dphi)
        ),
        "CARTESIAN": (*base.wo.T, *base.wi.T),
    }[how]  # fmt: skip
    out = {"brdf": "INV_STERADIAN", "ccbrdf": "INV_STERADIAN_COSINE_FACTOR"}[quantity]
    head = f"#DIM {len(columns)} 1\n#PARAM_IN {how}\n#PARAM_OUT {out}\n#VS 0\n"
    return (head + rows(*columns, held(base, quantity)[:, 0], separator=" ")).encode()


def pab_opto(base: Table, quantity: str) -> list[bytes]:
    a = {name: np.rad2deg(one) for name, one in angles(base).items()}
    found: list[bytes] = []
    for theta_i in np.unique(a["theta_i"]):
        here = a["theta_i"] == theta_i
        kind = {"brdf": "BSDF", "ccbrdf": "DSF"}[quantity]
        head = f"#sample_name s\n#intheta {float(theta_i)!r}\n#inphi 0\n#upphi 0\n#colorimetry: CIE-Y\n"
        head += f"#datapoints_in_file: {int(here.sum())}\n#format: theta phi {kind}\n"
        body = rows(a["theta_o"][here], a["phi_o"][here], held(base, quantity)[here, 0], separator=" ")
        found.append((head + body).encode())
    return found


ONE_CHANNEL: dict[str, Callable[[Table], Any]] = {
    "fred, degrees": lambda base: fred(base, "deg"), "fred, radians": lambda base: fred(base, "rad"),
    **{f"astm, {q}": (lambda base, q=q: astm(base, q)) for q in ("brdf", "ccbrdf", "reflectance_factor")},
    **{
        f"alta, {how}, {q}": (lambda base, how=how, q=q: alta(base, q, how))
        for how in ("ISOTROPIC_TL_TV_DPHI", "ISOTROPIC_TV_TL_DPHI", "ISOTROPIC_TL_TV_PROJ_DPHI", "CARTESIAN")
        for q in ("brdf", "ccbrdf")
    },
    **{f"pab-opto, {q}": (lambda base, q=q: pab_opto(base, q)) for q in ("brdf", "ccbrdf")},
}  # fmt: skip


@pytest.mark.parametrize("kind", ONE_CHANNEL)
def test_formats_of_one_channel(base: Table, kind: str):
    """The same samples, so the same fit: a fit is a function of them."""
    table = load_all(ONE_CHANNEL[kind](base))[0]
    assert table.metadata.source_format == kind.split(",")[0]
    assert (len(table), table.symmetry) == (len(base), "isotropic")
    for ours, theirs in zip(in_order(base), in_order(table), strict=True):
        np.testing.assert_allclose(theirs, ours, rtol=1e-13, atol=1e-13)


def in_order(table: Table) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    order = np.lexsort(np.round(np.concatenate([table.wi, table.wo], axis=1), 7).T)
    return table.wi[order], table.wo[order], table.value[order, 0]


def about_the_mirror() -> Table:
    i, a, r = (
        c.reshape(-1) for c in np.meshgrid(
            np.deg2rad([5.0, 25.0, 45.0]), np.deg2rad(np.arange(0.0, 181, 15)),
            np.deg2rad([0.0, 4, 8, 12, 20, 30, 40]), indexing="ij",
        )
    )  # fmt: skip
    wi, wo = directions.vector_from_spherical(i, 0.0), specular.outgoing(i, 0.0, r, a)
    value = reflectance(wi, wo)
    value[r == 0] = value[np.flatnonzero(r == 0)[0]]  # radial 0 is one direction, whatever the azimuth
    up = (wo[:, 2] > 0.01) & ((r > 0) | (a == 0))
    return Table(wi=wi[up], wo=wo[up], value=value[up], channels=CHANNELS)


#: format -> (how far the parameters of a fit may be off, a table that the format can hold as it is).
WRITTEN: dict[str, tuple[float, Callable[[], Table] | None]] = {
    "delimited": (0.0, None), "parquet": (0.0, None), "netcdf": (0.0, None), "astm": (SAME_FIT, None),
    "pab-opto": (SAME_FIT, None), "zemax": (SAME_FIT, about_the_mirror),
    "merl": (SAME_FIT, lambda: made(merl_grid((10, 9, 8)))),
    # float32
    "mbsdf": (1e-6, lambda: made(mbsdf_grid(9, 9))), "openexr": (1e-6, None),
}  # fmt: skip


@pytest.mark.parametrize("name", WRITTEN)
def test_written_and_read_it_is_fitted_alike(
    base: Table, best: dict[str, np.ndarray], name: str, tmp_path: Path
):
    tolerance, own = WRITTEN[name]
    table, expected = (base, best) if own is None else (own(), {})
    expected = expected or fitted(table)
    losses = write(table, tmp_path / "t", name)
    assert {loss.code for loss in losses} <= {"channels", "grid", "values"}
    back = load(tmp_path / "t")
    assert int(back.mask.sum()) == int(table.mask.sum())
    assert apart(expected, fitted(back)) <= tolerance


def test_every_format_that_can_be_written_is_among_them():
    assert {entry.name for entry in formats() if entry.write is not None} == {*WRITTEN, "rgl"}


def test_an_rgl_file_is_fitted_as_the_interpolant(
    base: Table, best: dict[str, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Its samples lie elsewhere than a table's: the format rounds to float32, interpolation widens lobes."""
    monkeypatch.setattr(rgl_writer, "_STEPS", ((10**6, (9,)),))
    write(base, tmp_path / "t.bsdf", "rgl")
    back = load(tmp_path / "t.bsdf")
    value, _ = base.evaluate(back.wi, back.wo)
    exact = Table(wi=back.wi, wo=back.wo, value=value, mask=back.mask, symmetry="isotropic")
    found = fitted(back)
    assert apart(fitted(exact), found) < 1e-7
    # A lobe of 0.2 rad on nodes 6 and 12 degrees apart.
    assert apart(best, found) < 0.1


def rich(table: Table) -> Table:
    """With everything that a table can say beside its values, and samples masked for every reason."""
    value = table.value.copy()
    mask, fills = np.ones(len(value), bool), np.zeros(len(value), bool)
    mask[3:6], fills[6], value[6], value[7, 1], value[8, 0] = False, True, -999.0, -0.25, np.nan
    given: dict[str, Any] = (
        {"grid": table.grid} if table.grid is not None else {"wi": table.wi, "wo": table.wo}
    )
    return Table(
        **given, value=value, sigma=0.01 * np.abs(np.nan_to_num(value)) + 1e-6, mask=mask, fills=fills,
        channels=[Channel("a", 500.25), Channel("b b", None), Channel("c", 700.0)],
        metadata=Metadata(
            name="A name", scale_uncertainty=0.02, angle_uncertainty=0.001, aperture=0.01,
            provenance={"operator": "A. B.", "lamp": 3},
        ),
    )  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", [*WRITTEN, "rgl"])
def test_what_does_not_come_back_is_named(base: Table, name: str, tmp_path: Path):
    own = WRITTEN.get(name, (0.0, None))[1]
    table = rich(base if own is None else own())
    if name in ("zemax", "pab-opto"):
        table.channels = tuple(Channel(c, 500.0 if c == "X" else None) for c in CHANNELS)
    losses = {loss.code for loss in write(table, tmp_path / "t", name)}
    back = load(tmp_path / "t", negatives="mask")
    there, here = back.metadata, table.metadata
    kept = {
        "samples": int(back.mask.sum()) == int(table.mask.sum()),
        "sigma": back.sigma is not None, "channels": back.channels == table.channels,
        "name": there.name == here.name, "symmetry": back.symmetry == table.symmetry,
        "grid": (back.grid is None) == (table.grid is None),
        "provenance": {**here.provenance, **there.provenance} == there.provenance,
        **{
            key: getattr(there, key) == getattr(here, key)
            for key in ("scale_uncertainty", "angle_uncertainty", "aperture")
        },
    }  # fmt: skip
    unsaid = {code for code, is_kept in kept.items() if not is_kept} - losses
    assert unsaid <= ({"samples", "grid"} if "resampled" in losses else set())
    if name in ("delimited", "parquet", "netcdf"):
        assert losses == set()
        np.testing.assert_array_equal(back.mask, table.mask)
        np.testing.assert_array_equal(back.value, table.value)
        np.testing.assert_array_equal(back.sigma, table.sigma)
        # A fill value that is negative stays unusable where negative values are kept.
        assert not load(tmp_path / "t", negatives="keep").mask[6]


def test_the_name_of_a_table_may_be_lost(base: Table, tmp_path: Path):
    table = Table(grid=base.grid, value=base.value, metadata=replace(base.metadata, name="Mine"))
    assert "name" not in {loss.code for loss in write(table, tmp_path / "t.astm", "astm")}
    assert load(tmp_path / "t.astm").metadata.name == "Mine"
