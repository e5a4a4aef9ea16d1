"""Generator of the sample tables: rough surfaces under a virtual gonioreflectometer.

    python data/generate.py              make every table anew and write SHA256SUMS
    python data/generate.py --check      verify the checksums
    python data/generate.py --quick      trace a few rows anew and compare them with the committed ones

Everything that is chosen is in tables/SETTINGS.toml.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
import tomllib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from goniometer import Facet, count_glints, gather_body, illuminate
from surface import FloatArray, HeightField, normals

TABLES = Path(__file__).resolve().parent / "tables"
SETTINGS, CHECKSUMS = TABLES / "SETTINGS.toml", TABLES / "SHA256SUMS"
CHANNELS = ("R", "G", "B")
#: What --quick traces anew: the table whose rows are independent of one another, its scan, that many rows.
QUICK = ("diffuse_plaster", 1, 24)
#: Independent random streams: (seed of the table, stream, scan, receiver).
SURFACE, LIGHT, RECEIVER, GEOMETRY, NOISE = range(5)


def stream(seed: int, *key: int) -> np.random.Generator:
    """The random stream of one purpose, so that any scan or row can be made alone."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *key])))


@dataclass(frozen=True)
class Scan:
    """One incidence: nominal angles in degrees; receivers (R, 2), (theta_o, phi_o) in the order measured."""

    number: int
    theta_i: float
    phi_i: float
    receivers: FloatArray


def settings() -> dict[str, dict[str, Any]]:
    """SETTINGS.toml as name -> settings of one table."""
    return tomllib.loads(SETTINGS.read_text(encoding="utf-8"))


def vector(theta_deg: FloatArray | float, phi_deg: FloatArray | float) -> FloatArray:
    """Unit vectors (3, ...) from degrees."""
    theta, phi = np.broadcast_arrays(np.deg2rad(theta_deg), np.deg2rad(phi_deg))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def scans_of(table: dict[str, Any]) -> list[Scan]:
    """Every scan with the receivers that the instrument can reach and did not lose."""
    plan = table["scans"]
    scans: list[Scan] = []
    for theta_i in plan["theta_i"]:
        for phi_i in plan["phi_i"]:
            number = len(scans)
            limit = plan["short"].get(str(number), plan["theta_o_max"])
            wanted = _sweeps(plan, theta_i, phi_i, limit)
            seen = wanted[~_hidden(table["instrument"], theta_i, phi_i, wanted)]
            lost = stream(table["seed"], GEOMETRY, number).random(len(seen))
            scans.append(Scan(number, theta_i, phi_i, seen[lost >= table["instrument"]["missing_share"]]))
    return scans


def _sweeps(plan: dict[str, Any], theta_i: float, phi_i: float, limit: float) -> FloatArray:
    """Receiver positions (R, 2) in degrees, sweep by sweep; a sweep's negative angles are its source side.

    First the plane of incidence, finer about the specular direction, then planes turned about the normal,
    then short sweeps close by the specular direction.
    """
    coarse = np.arange(-limit, limit + 1e-9, plan["step"])
    near = np.empty(0)
    if plan["fine_range"]:
        near = theta_i + np.arange(-plan["fine_range"], plan["fine_range"] + 1e-9, plan["fine_step"])
        near = near[np.abs(near) <= limit]
    sweeps = [(0.0, np.unique(np.round(np.concatenate([coarse, near]), 3)))]
    tilted = np.arange(plan["plane_step"], limit + 1e-9, plan["plane_step"])
    for azimuth in plan["planes"]:
        sweeps.append((azimuth, np.concatenate([-tilted[::-1], tilted])))
    for azimuth in plan["raster"]:
        beside = np.round(near[(near > 0) & (np.abs(near - theta_i) < 0.75 * plan["fine_range"])], 3)
        sweeps += [(-azimuth, beside), (azimuth, beside)]
    rows = [
        (abs(angle), (phi_i + azimuth + (180.0 if angle > 0 else 0.0)) % 360.0 if angle else 0.0)
        for azimuth, angles in sweeps
        for angle in angles
    ]
    # A raster position that a plane has already visited is not measured twice.
    return np.array(list(dict.fromkeys(rows)))


def _hidden(instrument: dict[str, Any], theta_i: float, phi_i: float, receivers: FloatArray) -> np.ndarray:
    """(R,) True behind the source's housing or the arm that carries it from the horizon."""
    theta, phi = receivers.T
    source, receiver = vector(theta_i, phi_i), vector(theta, phi)
    housing = np.rad2deg(np.arccos(np.clip(source @ receiver, -1.0, 1.0))) < instrument["housing_deg"]
    aside = np.deg2rad(phi - phi_i)
    off_arm = np.rad2deg(np.arcsin(np.clip(np.sin(np.deg2rad(theta)) * np.abs(np.sin(aside)), 0.0, 1.0)))
    arm = (np.cos(aside) > 0) & (theta > theta_i) & (off_arm < instrument["arm_half_width_deg"])
    return housing | arm


def surface_of(table: dict[str, Any]) -> HeightField:
    """The height field of a table."""
    given = table["surface"]
    return HeightField.gaussian(
        given["size"], tuple(given["correlation"]), given["rms_slope"], stream(table["seed"], SURFACE),
        given["skew"],
    )  # fmt: skip


def measure(table: dict[str, Any], field: HeightField, scan: Scan, rows: slice = slice(None)) -> list[str]:
    """The lines of one scan (or some of its rows), as the instrument writes them."""
    seed, instrument, light = table["seed"], table["instrument"], table["light"]
    facet = Facet.create(**table["facet"])
    aperture = np.deg2rad(instrument["aperture_deg"])
    # Where the arms really were: each scan has its own zero errors.
    error = instrument["angle_uncertainty_deg"] * normals(stream(seed, GEOMETRY, scan.number, 1), (2,))
    theta, phi = scan.receivers.T
    wi, wo = vector(scan.theta_i + error[0], scan.phi_i), vector(theta + error[1], phi)[:, rows]
    traced = illuminate(
        field, facet, wi, light["photons"], stream(seed, LIGHT, scan.number),
        spin=table["spin"], keep_arrivals=light["arrivals"],
    )  # fmt: skip
    index = range(len(theta))[rows]
    own = [stream(seed, RECEIVER, scan.number, r) for r in index]
    body, body_error = gather_body(field, facet, traced.arrivals, wo, aperture, light["rays"], own)
    glint, glint_error = count_glints(traced, wo, aperture)
    noise = normals(stream(seed, NOISE, scan.number), (2, len(theta), len(CHANNELS)))[:, rows]
    # The detector's own noise is constant in flux, that is in f_r cos(theta_o).
    flux = (body + glint) * (1.0 + instrument["scale_error"])
    flux = flux * (1.0 + instrument["relative_noise"] * noise[0]) + instrument["floor"] * noise[1]
    sigma = np.sqrt(
        (instrument["relative_noise"] * flux) ** 2 + instrument["floor"] ** 2 + body_error**2 + glint_error**2
    )
    cos_o = np.cos(np.deg2rad(theta[rows]))[:, None]
    columns = [flux / cos_o, sigma / cos_o][: 1 + instrument["state_sigma"]]
    values = np.concatenate(columns, axis=1)
    return [
        ",".join(f"{item:g}" for item in (scan.theta_i, scan.phi_i, theta[r], phi[r]))
        + "".join(f",{item:.6g}" for item in row)
        for r, row in zip(index, values, strict=True)
    ]


def header(name: str, table: dict[str, Any]) -> list[str]:
    """Comment lines that say what the table is, and the column names."""
    instrument = table["instrument"]
    facts = {
        "name": name,
        "description": table["description"],
        "quantity": "brdf",
        "symmetry": table["symmetry"],
        "scale_uncertainty": instrument["scale_uncertainty"],
        "aperture_deg": instrument["aperture_deg"],
        "angle_uncertainty_deg": instrument["angle_uncertainty_deg"],
        "provenance": "virtual gonioreflectometer over an explicit rough surface, data/generate.py; "
        "not a real material",
        "licence": "CC0-1.0",
    }
    columns = ["theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg", *(f"brdf_{c}" for c in CHANNELS)]
    if instrument["state_sigma"]:
        columns += [f"sigma_{c}" for c in CHANNELS]
    return [*(f"# {key}: {value}" for key, value in facts.items()), ",".join(columns)]


def _one(job: tuple[dict[str, Any], Scan]) -> list[str]:
    table, scan = job
    return measure(table, surface_of(table), scan)


def generate(names: Sequence[str], jobs: int) -> None:
    """Write the tables ``names`` with ``jobs`` processes; the bytes do not depend on their number."""
    known = settings()
    for name in names:
        start, table = time.perf_counter(), known[name]
        scans = scans_of(table)
        with ProcessPoolExecutor(jobs) as pool:
            parts = list(pool.map(_one, [(table, scan) for scan in scans]))
        lines = [*header(name, table), *(line for part in parts for line in part)]
        (TABLES / f"{name}.csv").write_bytes("".join(line + "\n" for line in lines).encode())
        seconds = time.perf_counter() - start
        print(f"{name}: {len(scans)} scans, {sum(map(len, parts))} rows, {seconds:.0f} s", file=sys.stderr)
    CHECKSUMS.write_bytes("".join(f"{digest(p)}  {p.name}\n" for p in _files()).encode())


def digest(path: Path) -> str:
    """sha256 of a file, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _files() -> list[Path]:
    return [SETTINGS, *sorted(TABLES.glob("*.csv"))]


def check() -> list[str]:
    """What does not match SHA256SUMS; empty when all is well."""
    stated = dict(line.split()[::-1] for line in CHECKSUMS.read_text(encoding="utf-8").splitlines())
    found = {path.name: digest(path) for path in _files()}
    return [name for name in sorted({*stated, *found}) if stated.get(name) != found.get(name)]


def quick() -> tuple[list[str], list[str]]:
    """(rows traced anew, the same rows as committed) of the slice ``QUICK``."""
    name, number, count = QUICK
    table = settings()[name]
    scan = scans_of(table)[number]
    rows = slice(0, len(scan.receivers), max(1, len(scan.receivers) // count))
    start = f"{scan.theta_i:g},{scan.phi_i:g},"
    lines = (TABLES / f"{name}.csv").read_text(encoding="utf-8").splitlines()
    return measure(table, surface_of(table), scan, rows), [x for x in lines if x.startswith(start)][rows]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; exit status 1 where a check failed."""
    parser = argparse.ArgumentParser(description="Make or verify the sample tables.")
    parser.add_argument("--check", action="store_true", help="verify the checksums only")
    parser.add_argument("--quick", action="store_true", help="trace a few rows anew and compare")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default 1); the result is the same")
    parser.add_argument("names", nargs="*", help="tables to make (default all)")
    options = parser.parse_args(arguments)
    if options.check:
        wrong = check()
        verdict = f"differs from SHA256SUMS: {', '.join(wrong)}" if wrong else "all checksums match"
        print(verdict, file=sys.stderr)
        return int(bool(wrong))
    if options.quick:
        new, committed = quick()
        same = sum(a == b for a, b in zip(new, committed, strict=True))
        print(f"{same} of {len(new)} rows of {QUICK[0]} come out the same", file=sys.stderr)
        return int(same != len(new))
    unknown = sorted(set(options.names) - set(settings()))
    if unknown:
        parser.error(f"no settings for {', '.join(unknown)}; there are {', '.join(settings())}")
    generate(options.names or list(settings()), max(1, options.jobs))
    return 0


if __name__ == "__main__":
    sys.exit(main())
