"""Physics of the virtual gonioreflectometer, and the committed tables against it."""

from __future__ import annotations

from pathlib import Path

import generate
import numpy as np
import pytest
from goniometer import Facet, cone_solid_angle, count_glints, gather_body, illuminate
from hypothesis import given
from hypothesis import strategies as st
from surface import HeightField, normals

APERTURE = np.deg2rad(4.0)


def rng(*key: int) -> np.random.Generator:
    return generate.stream(7, *key)


def rough(rms_slope: float = 0.6, skew: float = 0.0) -> HeightField:
    return HeightField.gaussian(128, (5.0, 5.0), rms_slope, rng(0), skew)


def read(
    field: HeightField, facet: Facet, wi: np.ndarray, wo: np.ndarray, photons: int, rays: int
) -> tuple[np.ndarray, np.ndarray]:
    """BRDF (R, C) of all light and its standard error."""
    light = illuminate(field, facet, wi, photons, rng(1), spin=True, keep_arrivals=photons)
    glint, glint_error = count_glints(light, wo, APERTURE)
    own = [rng(2, r) for r in range(wo.shape[1])]
    body, body_error = gather_body(field, facet, light.arrivals, wo, APERTURE, rays, own)
    return (glint + body).T / wo[2], np.hypot(glint_error, body_error).T / wo[2]


def test_checksums_match() -> None:
    assert generate.check() == []


def test_a_changed_table_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "SETTINGS.toml").write_text("")
    (tmp_path / "a.csv").write_text("1\n")
    (tmp_path / "SHA256SUMS").write_text(f"{generate.digest(tmp_path / 'a.csv')}  a.csv\n")
    for name, path in (("TABLES", ""), ("SETTINGS", "SETTINGS.toml"), ("CHECKSUMS", "SHA256SUMS")):
        monkeypatch.setattr(generate, name, tmp_path / path)
    assert generate.check() == ["SETTINGS.toml"]
    (tmp_path / "a.csv").write_text("2\n")
    assert generate.check() == ["SETTINGS.toml", "a.csv"]


def test_quick_regeneration_gives_the_committed_rows() -> None:
    new, committed = generate.quick()
    assert len(new) >= 20
    assert new == committed


@pytest.mark.parametrize("name", list(generate.settings()))
def test_committed_geometries_are_the_planned_ones(name: str) -> None:
    table = generate.settings()[name]
    lines = (generate.TABLES / f"{name}.csv").read_text(encoding="utf-8").splitlines()
    assert lines[: len(generate.header(name, table))] == generate.header(name, table)
    measured = [line.split(",")[:4] for line in lines if line[0].isdigit()]
    planned = [
        [f"{a:g}" for a in (scan.theta_i, scan.phi_i, theta, phi)]
        for scan in generate.scans_of(table)
        for theta, phi in scan.receivers
    ]
    assert measured == planned


def test_metal_peak_is_traced_again_with_fewer_photons() -> None:
    table = generate.settings()["brushed_metal"]
    scan = generate.scans_of(table)[0]
    wi, wo = generate.vector(scan.theta_i, scan.phi_i), generate.vector(scan.theta_i, [scan.phi_i + 180.0])
    facet = Facet.create(**table["facet"])
    light = illuminate(generate.surface_of(table), facet, wi, 300_000, rng(3), spin=False)
    value, error = count_glints(light, wo, np.deg2rad(table["instrument"]["aperture_deg"]))
    rows = np.genfromtxt(
        (generate.TABLES / "brushed_metal.csv"), delimiter=",", comments="#",
        skip_header=len(generate.header("brushed_metal", table)), max_rows=len(scan.receivers),
    )  # fmt: skip
    peak = rows[np.all(np.isclose(rows[:, 2:4], [scan.theta_i, 180.0]), axis=1)]
    if not len(peak):
        pytest.fail("the reading at the peak is missing: choose another scan")
    # Within counting noise, instrument noise, scale and angle errors, all independent.
    allowed = 4.0 * np.hypot(error[0] / wo[2, 0], 0.03 * peak[0, 4:7])
    assert np.all(np.abs(value[0] / wo[2, 0] - peak[0, 4:7]) < allowed)


def test_random_normals_are_normal() -> None:
    draws = normals(rng(4), (200_000,))
    assert draws.mean() == pytest.approx(0.0, abs=0.01)
    assert draws.std() == pytest.approx(1.0, abs=0.01)
    assert (draws**4).mean() == pytest.approx(3.0, abs=0.1)


@given(st.floats(0, 89), st.floats(0, 360), st.integers(0, 100))
def test_rays_meet_the_surface_where_it_is(theta: float, phi: float, seed: int) -> None:
    field, count = rough(), 64
    d = -np.repeat(generate.vector(theta, phi)[:, None], count, axis=1)
    place = rng(5, seed).random((2, count)) * field.size
    o = np.stack([*place, np.full(count, field.top + 0.5)])
    hits = field.intersect(o, d, o[2] - field.height_at(o[0], o[1]))
    assert hits.hit.all()
    x, y, z = hits.position
    # Steep facets and long rays magnify the rounding of x and y.
    assert np.abs(field.height_at(x, y) - z).max() < 1e-9
    assert (hits.normal * d).sum(axis=0).max() < 1e-9
    # No point of the way lies under the surface.
    for share in np.linspace(0.0, 1.0, 200, endpoint=False):
        x, y, z = o + share * (hits.position - o)
        assert (z - field.height_at(x, y)).min() > -1e-9


def test_surface_has_the_slopes_asked_for() -> None:
    field = HeightField.gaussian(512, (16.0, 5.0), 0.16, rng(6), skew=-0.3)
    assert field.rms_slopes() == pytest.approx((0.05, 0.16), rel=0.06)
    with pytest.raises(ValueError, match="power of two"):
        HeightField(np.zeros((6, 6)))


def test_flat_lambertian_surface_is_rho_over_pi() -> None:
    wo = generate.vector(np.array([0.0, 40.0, 80.0]), np.array([0.0, 70.0, 180.0]))
    facet = Facet.create("lambert", albedo=[0.9, 0.5, 0.1])
    value, error = read(HeightField.flat(), facet, generate.vector(30.0, 0.0), wo, 2_000, 2_000)
    rho = np.array([[0.9], [0.5], [0.1]]) / np.pi
    # A cone's mean cosine is cos^2(aperture / 4) of its axis' cosine.
    assert np.all(np.abs(value - rho * np.cos(APERTURE / 4) ** 2) < 4.0 * error + 1e-6)


def test_flat_mirror_sends_everything_into_the_specular_receiver() -> None:
    facet = Facet.create("conductor", eta=0.2, k=3.0)
    wi = generate.vector(60.0, 10.0)
    light = illuminate(HeightField.flat(), facet, wi, 5_000, rng(8), spin=False)
    wo = generate.vector(np.array([60.0, 55.0]), np.array([190.0, 190.0]))
    flux, _ = count_glints(light, wo, APERTURE)
    assert flux[0] * cone_solid_angle(APERTURE) == pytest.approx(0.918411, abs=1e-6)
    assert flux[1] == pytest.approx(0.0)


@pytest.mark.measured
@pytest.mark.parametrize("kind", ["dielectric", "conductor"])
def test_fresnel_agrees_with_the_oracle(kind: str, shared: Path) -> None:
    rows = np.genfromtxt(shared / "oracles" / f"fresnel_{kind}.csv", delimiter=",", names=True, skip_header=1)
    for row in rows:
        facet = Facet.create(kind, eta=row["n"], k=row["k"] if kind == "conductor" else 0.0)
        found = facet.specular(np.cos(np.deg2rad([row["theta_deg"]])))
        assert found[:, 0] == pytest.approx(row["reflectance"], abs=1e-6)


@pytest.mark.parametrize("theta_i", [0.0, 50.0, 80.0])
@pytest.mark.parametrize("kind", ["lambert", "dielectric", "conductor"])
def test_energy_is_kept(kind: str, theta_i: float) -> None:
    """A surface that absorbs nothing gives everything back; one that absorbs, less than its facets would."""
    metal = kind == "conductor"
    white = Facet.create(kind, albedo=1.0, eta=1e-9 if metal else 1.5, k=5.0 * metal)
    grey = Facet.create(kind, albedo=0.5, eta=1.5, k=5.0 * metal)
    field, wi = rough(0.6), generate.vector(theta_i, 0.0)
    light = illuminate(field, white, wi, 4_000, rng(9), spin=True)
    assert np.all(np.abs(light.albedo - 1.0) < 4.0 * light.albedo_error + 1e-6)
    light = illuminate(field, grey, wi, 4_000, rng(9), spin=True)
    assert np.all(light.albedo < 0.95)


def test_receivers_gather_what_photons_carry_away() -> None:
    """The integral of f_r cos(theta_o) over the hemisphere is the albedo of the same photons."""
    facet = Facet.create("lambert", albedo=[0.9, 0.6, 0.3])
    node, weight = np.polynomial.legendre.leggauss(12)
    azimuth = np.arange(12) * 30.0
    mu, phi = (a.ravel() for a in np.meshgrid(0.5 * (node + 1.0), azimuth, indexing="ij"))
    wo = generate.vector(np.rad2deg(np.arccos(mu)), phi)
    value, error = read(rough(), facet, generate.vector(50.0, 0.0), wo, 20_000, 400)
    share = np.repeat(0.5 * weight, 12) * (2.0 * np.pi / 12) * mu
    light = illuminate(rough(), facet, generate.vector(50.0, 0.0), 20_000, rng(1), spin=True)
    noise = np.hypot(np.sqrt(((error * share) ** 2).sum(axis=1)), light.albedo_error)
    # The rays share arrivals, which makes their errors somewhat dependent.
    assert np.all(np.abs((value * share).sum(axis=1) - light.albedo) < 6.0 * noise)


@pytest.mark.parametrize("kind", ["lambert", "dielectric"])
def test_source_and_receiver_can_be_exchanged(kind: str) -> None:
    facet = Facet.create(kind, albedo=[0.9, 0.5, 0.2], eta=1.5)
    field = rough(0.35, skew=-0.3)
    values, errors = [], []
    for theta_i, theta_o in ((20.0, 55.0), (55.0, 20.0)):
        wi = generate.vector(theta_i, 0.0)
        wo = generate.vector(np.full(3, theta_o), np.array([40.0, 120.0, 180.0]))
        value, error = read(field, facet, wi, wo, 150_000 if kind == "dielectric" else 20_000, 4_000)
        values.append(value)
        errors.append(error)
    difference, noise = values[0] - values[1], np.hypot(*errors)
    assert np.all(np.abs(difference) < 4.5 * noise)
    assert np.all(noise < 0.1 * values[0])


def test_scans_do_not_depend_on_each_other() -> None:
    table = generate.settings()["diffuse_plaster"]
    table["light"] = {"photons": 500, "arrivals": 500, "rays": 20}
    table["surface"]["size"] = 64
    field, scan = generate.surface_of(table), generate.scans_of(table)[3]
    whole = generate.measure(table, field, scan)
    assert generate.measure(table, field, scan, slice(3, 9)) == whole[3:9]
    assert len(whole) == len(scan.receivers)


def test_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert generate.main(["--check"]) == 0
    assert "all checksums match" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        generate.main(["no_such_table"])
