"""Small valid files of every format, made without the project's readers or writers."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import Any


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


@dataclass(frozen=True)
class Sample:
    """A small file: its format's name, its bytes, how many samples it holds."""

    name: str
    data: bytes
    samples: int
    options: dict[str, Any] = field(default_factory=dict)


SAMPLES = [
    Sample("delimited", delimited_bytes(), 36),
    Sample("astm", astm_bytes(), 27),
    Sample("merl", merl_bytes(), 120),
    Sample("alta", alta_bytes(), 27),
]
