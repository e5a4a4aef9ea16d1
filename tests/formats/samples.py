"""Small valid files of every format, made without the project's readers or writers."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
import OpenEXR
import pyarrow
import pyarrow.parquet
from scipy.io import netcdf_file

from tests.formats.hdf5_bytes import Var, hdf5


def delimited_bytes() -> bytes:
    rows = ["# quantity: brdf", "# name: small", "theta_i_deg,theta_o_deg,dphi_deg,brdf_R,brdf_550nm"]
    for theta_i in (10, 30, 50):
        for theta_o in (5, 25, 45, 65):
            for dphi in (0, 90, 180):
                f = 0.3 + (1.0 if dphi == 180 and abs(theta_i - theta_o) <= 5 else 0.0)
                rows.append(f"{theta_i},{theta_o},{dphi},{f},{f / 2}")
    return "\n".join(rows).encode() + b"\n"


def astm_bytes() -> bytes:
    rows = []
    for theta_i in (0.2, 0.6, 1.0):
        for theta_s in (0.2, 0.6, 1.0):
            for phi_s in (-1.5, 0.0, 3.141593):
                f = 2.0 if phi_s > 3 and theta_i == theta_s else 0.1
                rows.append(f"{theta_i:.6f},0.000000,{theta_s:.6f},{phi_s:.6f},{f},{f / 2},{f / 4}")
    head = [
        "LAB_NAME A laboratory", "SAMPLE_NAME Small", "MEAS_NAME BRDF", f"NUM_POINTS {len(rows)}",
        "VARS theta_i,phi_i,theta_s,phi_s,R,G,B", "",
    ]  # fmt: skip
    return "\r\n".join([*head, *rows, ""]).encode()


def merl_bytes(dims: tuple[int, int, int] = (4, 5, 6), value: float = 150.0) -> bytes:
    n = math.prod(dims)
    return struct.pack("<3i", *dims) + struct.pack(f"<{3 * n}d", *(value + k for k in range(3 * n)))


def alta_bytes() -> bytes:
    rows = ['#SAMPLE "small"', "#DIM 3 1", "#VS 0", "#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI"]
    rows.append("#PARAM_OUT INV_STERADIAN")
    for theta_l in (0.25, 0.5, 1.0):
        for theta_v in (0.25, 0.5, 1.0):
            for dphi in (0.0, 1.5, 3.0):
                f = 5.0 if dphi == 0 and theta_l == theta_v else 0.2
                rows.append(f"{theta_l}  {theta_v * math.cos(dphi)}  {theta_v * math.sin(dphi)}  {f}")
    return "\n".join(rows).encode() + b"\n"


def alta_binary_bytes(endian: str = "little", intervals: int = 0) -> bytes:
    """The rows of ``alta_bytes`` in ALTA's binary form."""
    rows = [[float(cell) for cell in line.split()] for line in alta_bytes().decode().splitlines()[5:]]
    head = ["#DIM 3 1", "#PARAM_IN  ISOTROPIC_TL_TV_PROJ_DPHI", "#PARAM_OUT INV_STERADIAN"]
    head += ["#FORMAT binary", "#VERSION 0", "#PRECISION ieee754-double", f"#SAMPLE_COUNT {len(rows)}"]
    head += [f"#VS {intervals}", f"#ENDIAN {endian}", "#BEGIN_STREAM", ""]
    order = "<" if endian == "little" else ">"
    body = b"".join(
        struct.pack(f"{order}{4 + intervals}d", *row, *[0.5] * intervals) for row in rows
    )  # fmt: skip
    return "\n".join(head).encode() + body + b"\n#END_STREAM\n"


def zemax_bytes() -> bytes:
    rows = ["# Light source: laser (633 nm)", "Source\tMeasured", "Symmetry\tPlaneSymmetrical"]
    rows += ["SpectralContent\tMonochrome", "ScatterType\tBRDF", "SampleRotation\t1", "0"]
    rows += ["AngleOfIncidence\t2", "20\t60", "ScatterAzimuth\t3", "0\t90\t180", "ScatterRadial\t3"]
    rows += ["0\t20\t40", "", "Monochrome", "DataBegin"]
    rows += ["TIS\t0.1", "1.0\t0.5\t0.2", "1.0\t0.4\t0.1", "1.0\t0.3\t0.05"]
    rows += ["TIS\t0.2", "2.0\t0.5\t0.2", "2.0\t0.4\t0.1", "2.0\t0.0e+00\t0.0e+00", "DataEnd"]
    return "\n".join(rows).encode() + b"\n"


def fred_bytes() -> bytes:
    rows = ["type bsdf_data", "format angles=deg bsdf=value scale=1"]
    for theta_i in (10, 30, 50):
        rows.append(f"{theta_i}\t0")
        for theta_s in (10, 30, 50, 70):
            for phi_s in (0, 90, 180):
                rows.append(f"{theta_s}\t{phi_s}\t{3.0 if phi_s == 0 and theta_s == theta_i else 0.1:.6f}")
    return "\n".join(rows).encode() + b"\n"


def pabopto_bytes(
    theta_i: float = 30.0, phi_i: float = 0.0, quantity: str = "BSDF", name: str = "s"
) -> bytes:
    """Three reflected rows (mirror, retro, aside) and a transmitted one."""
    rows = [f'#sample_name "{name}"', f"#intheta {theta_i}", f"#inphi {phi_i}", "#upphi 0"]
    rows += ["#colorimetry: CIE-Y", f"#format: theta phi {quantity}", "#datapoints_in_file: 4"]
    front = theta_i <= 90
    rows += [f"{theta_i} {phi_i + 180} 2.0", f"{theta_i} {phi_i} 0.5"]
    rows += [f"{60 if front else 120} {phi_i + 90} 0.25", f"{150 if front else 30} {phi_i + 180} 9.0"]
    return "\r\n".join(rows).encode() + b"\r\n"


def curet_files(samples: int = 2, seed: int = 1) -> tuple[bytes, bytes]:
    """``(abrdf.dat, table.txt)`` of made-up values; geometry 1 is a mirror pair, 2 a retro pair."""
    angles = [(0.5, 1.0, 0.5, 1.0 - math.pi), (0.5, 1.0, 0.5, 1.0)]
    angles += [(0.2 + 0.005 * k, 0.01 * k, 0.9, 0.02 * k) for k in range(203)]
    table = [f"{k:3d} " + " ".join(f"{a:11.6f}" for a in row) for k, row in enumerate(angles, start=1)]
    lines = []
    for sample in range(1, samples + 1):
        values = [(sample * seed * (k + 7) % 97) / 100 for k in range(205)]
        lines.append(f"{5 * sample:2d}  " + "".join(f"{v:8.3f}" for v in values))
    return "\n".join(lines).encode() + b"\n", "\n".join(table).encode()


def lighttools_bytes() -> bytes:
    rows = ["# made up", "Symmetry Asymmetric", "SpectralContent Monochrome"]
    rows += ["ScatterAzimuth 4", "0 90 180 270", "ScatterRadial 3", "20 40 60", "DataBegin"]
    for aoi in (20, 40):
        for kind in ("BRDF", "BTDF"):
            rows += [f"AOI {aoi}", "POI 0", "Side Front", "Wavelength 550", f"ScatterType {kind}", "TIS 0.1"]
            for phi in (0, 90, 180, 270):
                rows.append(" ".join(str(4.0 if phi == 270 and r == aoi else 0.1) for r in (20, 40, 60)))
    return "\n".join([*rows, "DataEnd", ""]).encode()


def integra_bytes() -> bytes:
    rows = ["; made up", "Source Measured", "TypeSym PlaneSymmetrical", "TypeColorModel rgb"]
    rows += ["TypeData Luminance Absolute", "sigma 2", "20 60", "phi 3", "0 90 180", "theta 3", "0 20 40"]
    for k, channel in enumerate(("red", "gre", "blu"), start=1):
        rows += [channel, "kbdf", "1.0 0.5", "def"]
        for _ in range(2):
            rows += [f"{3.0 * k} {2.0 * k} {1.0 * k}"] * 3
    return "\n".join([*rows, ""]).encode()


def ssdd_bytes(data: str = "ascii", dtype: str = "f") -> bytes:
    head = ["VERSION 0.3", "# made up", "DATA_TYPE specular_reflectance", "COLOR_MODEL monochrome"]
    head += ["PARAM0_LIST 0 90", "DATA ascii", "0.05", "0.1", "DATA_TYPE brdf", "COLOR_MODEL rgb"]
    head += ["PARAM_TYPE spherical_coordinate_system", "PARAM0_LIST 20 60", "PARAM2_LIST 20 40 60"]
    head += ["PARAM3_LIST 0 90 180", "NAME made up", f"DATA {data}"]
    values = []
    for phi_o in (0, 90, 180):
        for theta_o in (20, 40, 60):
            for theta_i in (20, 60):
                f = 8.0 if phi_o == 180 and theta_o == theta_i else 0.5
                values.append((f, f / 2, f / 4))
    start = "\n".join([*head, ""]).encode()
    if data == "binary":
        return start + b"".join(struct.pack(f"<3{dtype}", *row) for row in values)
    return start + "".join(f"{r} {g} {b}\n" for r, g, b in values).encode()


def parquet_bytes() -> bytes:
    """The rows of ``delimited_bytes`` (:mod:`tests.formats.test_parquet` relies on that)."""
    columns: dict[str, list[float]] = {
        name: [] for name in ("theta_i_deg", "theta_o_deg", "dphi_deg", "brdf_R", "brdf_550nm")
    }
    for line in delimited_bytes().decode().splitlines()[3:]:
        for column, cell in zip(columns.values(), line.split(","), strict=True):
            column.append(float(cell))
    sink = pyarrow.BufferOutputStream()
    table = pyarrow.table(columns, metadata={"quantity": "brdf", "name": "small", "operator": "A. B."})
    pyarrow.parquet.write_table(table, sink)
    return sink.getvalue().to_pybytes()


def netcdf_bytes() -> bytes:
    """The grid of ``delimited_bytes`` as axes and arrays: theta_i, theta_o and dphi are coordinates."""
    sink = BytesIO()
    file: Any = netcdf_file(sink, "w")
    file.Conventions, file.quantity, file.title = b"CF-1.8", b"brdf", b"made up"
    axes = {"theta_i": [10, 30, 50], "theta_o": [5, 25, 45, 65], "dphi": [0, 90, 180]}
    for name, nodes in axes.items():
        file.createDimension(name, len(nodes))
        variable = file.createVariable(name, "f", (name,))
        variable[:], variable.units = nodes, b"degrees"
    rows = [float(line.split(",")[3]) for line in delimited_bytes().decode().splitlines()[3:]]
    for name, share in (("brdf_R", 1.0), ("brdf_550nm", 0.5)):
        variable = file.createVariable(name, "d", tuple(axes))
        variable[:], variable.units = np.reshape(rows, (3, 4, 3)) * share, b"sr-1"
    file.flush()
    return sink.getvalue()


def hdf5_bytes() -> bytes:
    """The grid of ``delimited_bytes`` with dimension scales, one variable of it in packed chunks."""
    axes = {"theta_i": [10, 30, 50], "theta_o": [5, 25, 45, 65], "dphi": [0, 90, 180]}
    rows = [float(line.split(",")[3]) for line in delimited_bytes().decode().splitlines()[3:]]
    values = np.reshape(rows, (3, 4, 3))
    variables = {
        name: Var(np.array(nodes, "f4"), (name,), {"units": "degrees"}) for name, nodes in axes.items()
    }
    variables["brdf_R"] = Var(values, tuple(axes), {"units": "sr-1"}, chunks=(2, 3, 2))
    variables["brdf_550nm"] = Var(values / 2, tuple(axes))
    return hdf5(variables, Conventions="CF-1.8", quantity="brdf", title="made up")


#: A basis of 11 patches: (lower, upper, patches) of each band, degrees.
KLEMS_BANDS = ((0.0, 20.0, 1), (20.0, 60.0, 4), (60.0, 90.0, 6))


def klems_basis_xml(bands: Sequence[tuple[float, float, int]] = KLEMS_BANDS, name: str = "made up") -> str:
    rows = ["<AngleBasis>", f"<AngleBasisName>{name}</AngleBasisName>"]
    for lower, upper, count in bands:
        rows += [f"<AngleBasisBlock><Theta>{(lower + upper) / 2 if lower else 0}</Theta>"]
        rows += [f"<nPhis>{count}</nPhis><ThetaBounds><LowerTheta>{lower}</LowerTheta>"]
        rows += [f"<UpperTheta>{upper}</UpperTheta></ThetaBounds></AngleBasisBlock>"]
    return "\n".join([*rows, "</AngleBasis>"])


def klems_block_xml(direction: str, values: str, wavelength: str = "Visible", basis: str = "made up") -> str:
    return (
        f'<WavelengthData><LayerNumber>System</LayerNumber><Wavelength unit="Integral">{wavelength}'
        f"</Wavelength>\n<WavelengthDataBlock><WavelengthDataDirection>{direction}</WavelengthDataDirection>"
        f"<ColumnAngleBasis>{basis}</ColumnAngleBasis><RowAngleBasis>{basis}</RowAngleBasis>"
        f"<ScatteringDataType>BTDF</ScatteringDataType>\n<ScatteringData>\n{values}</ScatteringData>"
        "</WavelengthDataBlock></WavelengthData>"
    )


def klems_bytes(
    blocks: Sequence[str] | None = None, basis: str | None = None, structure: str = "Columns"
) -> bytes:
    """By default one reflection block with its peak on the diagonal, and one transmission block."""
    if blocks is None:
        values = "".join(
            ", ".join(str(3.0 + i if i == j else 0.1 + 0.01 * i) for j in range(11)) + ",\n"
            for i in range(11)
        )
        blocks = [klems_block_xml("Transmission Front", values), klems_block_xml("Reflection Front", values)]
    return "\n".join([
        '<?xml version="1.0" encoding="UTF-8"?>', '<WindowElement xmlns="http://windows.lbl.gov">',
        "<WindowElementType>System</WindowElementType>", "<Optical><Layer><Material><Name>made up</Name>",
        "<Manufacturer>nobody</Manufacturer></Material><DataDefinition>",
        f"<IncidentDataStructure>{structure}</IncidentDataStructure>",
        klems_basis_xml() if basis is None else basis, "</DataDefinition>", *blocks,
        "</Layer></Optical></WindowElement>",
    ]).encode()  # fmt: skip


def tensor_tree_bytes(
    trees: Sequence[str] | None = None, rank: int = 3, direction: str = "Reflection Back"
) -> bytes:
    """By default a tree of three dimensions: a grid of 2 x 2 x 2 values."""
    if trees is None:
        trees = ["{ " + " ".join(str(1.0 + k) for k in range(8)) + " }"]
    words = ("Visible", "CIE-X", "CIE-Z")
    blocks = [
        f'<WavelengthData><Wavelength unit="Integral">{word}</Wavelength><WavelengthDataBlock>'
        f"<WavelengthDataDirection>{direction}</WavelengthDataDirection>"
        "<AngleBasis>LBNL/Shirley-Chiu</AngleBasis><ScatteringDataType>BTDF</ScatteringDataType>"
        f"<ScatteringData>\n{tree}\n</ScatteringData></WavelengthDataBlock></WavelengthData>"
        for word, tree in zip(words, trees, strict=False)
    ]
    return klems_bytes(blocks, "", f"TensorTree{rank}")


def openexr_bytes() -> bytes:
    """Slices of two incidences, four rows of theta_o and three columns of dphi, with mirror peaks."""
    said = {
        "slices": "1", "system": "spherical_isotropic", "pixels": '{"brdf_R": "R", "brdf_550nm": "550nm"}',
        "theta_o": json.dumps([math.radians(a) for a in (10, 30, 50, 70)]),
        "dphi": json.dumps([0.0, math.pi / 2, math.pi]), "quantity": "brdf", "name": "small", "lab": "A. B.",
    }  # fmt: skip
    parts = []
    for k, theta_i in enumerate((10, 50)):
        f = np.full((4, 3), 0.25, np.float32)
        f[2 * k, 2] = 3.0
        header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        header["brdf.theta_i"] = repr(math.radians(theta_i))
        header |= {f"brdf.{key}": text for key, text in said.items()} if k == 0 else {}
        parts.append(OpenEXR.Part(header, {"R": f, "550nm": f / 2}, f"slice {k}"))
    sink = BytesIO()
    OpenEXR.File(parts).write(sink)
    return sink.getvalue()


TENSOR_TYPES = {"B": 1, "H": 3, "I": 5, "f": 10, "d": 11}


def tensor_file(fields: dict[str, tuple[str, tuple[int, ...], list[float]]], version: int = 1) -> bytes:
    """A tensor file of name -> (type as in struct, shape, values)."""
    at = 18 + sum(13 + len(name) + 8 * len(shape) for name, (_, shape, _) in fields.items())
    head, body = struct.pack("<12sBBI", b"tensor_file\0", version, 0, len(fields)), b""
    for name, (kind, shape, values) in fields.items():
        head += struct.pack("<H", len(name)) + name.encode()
        head += struct.pack(f"<HBQ{len(shape)}Q", len(shape), TENSOR_TYPES[kind], at + len(body), *shape)
        assert len(values) == math.prod(shape)
        body += struct.pack(f"<{len(values)}{kind}", *(v if kind in "fd" else int(v) for v in values))
    return head + body


def rgl_fields(
    phi_i: tuple[float, ...] = (0.0,), spectral: bool = False, resolution: int = 4
) -> dict[str, tuple[str, tuple[int, ...], list[float]]]:
    """Fields of an RGL file whose warp is the identity: all visible normals alike in the unit square."""
    theta_i, n, channels = (0.0, 0.5, 1.0), resolution, 4 if spectral else 3
    text = b"made up"
    nodes = len(phi_i) * len(theta_i)
    data = [0.25 + (7 * k % 23) / 23 for k in range(nodes * channels * n * n)]
    fields: dict[str, tuple[str, tuple[int, ...], list[float]]] = {
        "version": ("I", (2,), [1, 0]),
        "description": ("B", (len(text),), list(text)),
        "phi_i": ("f", (len(phi_i),), list(phi_i)),
        "theta_i": ("f", (3,), list(theta_i)),
        "sigma": ("f", (2, 3), [1.0, 0.75, 0.5] * 2),
        "ndf": ("f", (2, 3), [4.0, 1.0, 0.0] * 2),
        "vndf": ("f", (len(phi_i), 3, 3, 5), [2.0] * (nodes * 15)),
        "luminance": ("f", (len(phi_i), 3, n, n), [1.0] * (nodes * n * n)),
        "jacobian": ("B", (1,), [1]),
    }
    if spectral:
        fields["wavelengths"] = ("f", (4,), [400.0, 500.1, 600.0, 700.0])
    fields["spectra" if spectral else "rgb"] = ("f", (len(phi_i), 3, channels, n, n), data)
    return fields


def rgl_bytes() -> bytes:
    return tensor_file(rgl_fields())


def mbsdf_bytes(theta: int = 4, phi: int = 5, channels: int = 3, part: str = "_REFLECTION") -> bytes:
    """Values that tell their own cell: theta_in + theta_out / 10 + phi / 100 + channel / 1000."""
    values = [
        i + o / 10 + p / 100 + c / 1000
        for i in range(theta) for o in range(theta) for p in range(phi) for c in range(channels)
    ]  # fmt: skip
    head = f"NVIDIA ARC MBSDF V1\nMBSDF_DATA{part}=\n".encode()
    return head + struct.pack(f"<3I{len(values)}f", channels == 3, theta, phi, *values)


@dataclass(frozen=True)
class Sample:
    """A small file: its format's name, its bytes, how many samples it holds.

    gridded : whether its rows fill a product grid. counted : whether it says how many values it has.
    """

    name: str
    data: bytes
    samples: int
    gridded: bool = True
    counted: bool = True


SAMPLES = [
    Sample("delimited", delimited_bytes(), 36, counted=False),
    Sample("astm", astm_bytes(), 27),
    Sample("merl", merl_bytes(), 120),
    # Its projected azimuths come back with rounding of their own.
    Sample("alta", alta_bytes(), 27, gridded=False, counted=False),
    Sample("alta", alta_binary_bytes(), 27, gridded=False),
    Sample("zemax", zemax_bytes(), 18, gridded=False),
    Sample("lighttools", lighttools_bytes(), 24),
    Sample("integra", integra_bytes(), 18, gridded=False),
    Sample("ssdd", ssdd_bytes(), 18),
    Sample("pab-opto", pabopto_bytes(), 3, gridded=False, counted=False),
    Sample("parquet", parquet_bytes(), 36),
    Sample("netcdf", netcdf_bytes(), 36),
    Sample("hdf5", hdf5_bytes(), 36),
    Sample("klems", klems_bytes(), 121, gridded=False),
    Sample("tensor-tree", tensor_tree_bytes(), 256, gridded=False),
    Sample("openexr", openexr_bytes(), 24),
    Sample("fred", fred_bytes(), 36, counted=False),
    Sample("rgl", rgl_bytes(), 48, gridded=False),
    Sample("mbsdf", mbsdf_bytes(), 80),
]
