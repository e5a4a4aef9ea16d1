"""OpenPBR: MaterialX's open_pbr_surface, refitted; brushed surfaces too."""

from __future__ import annotations

import math
from pathlib import Path

from fitter.export.materialx import write_surface
from fitter.export.openpbr import openpbr
from fitter.export.refit import Unknown, refit
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject

_UNKNOWNS = (
    Unknown("base_color", 0.0, 1.0, (0.3,), per_channel=True),
    Unknown("base_diffuse_roughness", 0.0, 1.0, (0.2,)),
    Unknown("base_metalness", 0.0, 1.0, (0.05, 0.95)),
    Unknown("specular_color", 0.0, 1.0, (0.9,), per_channel=True),
    Unknown("specular_roughness", 0.03, 1.0, (0.2, 0.6)),
    Unknown("specular_ior", 1.0, 3.0, (1.5,)),
)
_BRUSHED = (
    Unknown("specular_roughness_anisotropy", 0.0, 0.99, (0.5,)),
    Unknown("psi", -math.pi, math.pi, (0.0, math.pi / 2)),
)


_WORLD = '<input name="space" type="string" value="world" />'


def write(subject: Subject, path: Path) -> Written:
    brushed = subject.symmetry == "anisotropic"
    unknowns = (*_UNKNOWNS, *(_BRUSHED if brushed else ()))
    found = refit(subject, "OpenPBR Surface", unknowns, openpbr(len(subject.channels)))
    given = [(name, value) for name, value in found.values.items() if name != "psi"]
    tangent: tuple[str, ...] = ()
    if brushed:
        # MaterialX turns clockwise about the axis.
        degrees = -math.degrees(float(found.values["psi"]))
        tangent = (
            f'<normal name="normal" type="vector3">{_WORLD}</normal>',
            f'<tangent name="tangent" type="vector3">{_WORLD}</tangent>',
            '<rotate3d name="turned" type="vector3">',
            '  <input name="in" type="vector3" nodename="tangent" />',
            f'  <input name="amount" type="float" value="{degrees:.9g}" />',
            '  <input name="axis" type="vector3" nodename="normal" />',
            "</rotate3d>",
        )
    write_surface(path, subject, found, "open_pbr_surface", given, f"{TARGET.convention}.", tangent)
    return Written((found.note(),), found.residuals())


TARGET = Target(
    "openpbr", "MaterialX document with an OpenPBR surface, a refit", True, True, ".mtlx",
    "linear Rec. 709 inputs of open_pbr_surface; specular_roughness is the root of alpha", write,
    "application/xml", channels=(1, 3),
)  # fmt: skip
