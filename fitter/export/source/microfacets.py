"""Lines for distributions of microfacets and their masking: see :mod:`fitter.models.ndf` and ``masking``.

Smith's term of Blinn's and of the Gaussian distribution is an integral; the models hold it as a Chebyshev
series over the direction, whose coefficients depend on the parameter alone and are computed here.
"""

from __future__ import annotations

from typing import cast

import jax.numpy as jnp
import numpy as np

from fitter.errors import SpecError
from fitter.export.source import parts
from fitter.export.source.formula import Argument, derived
from fitter.models import ReflectanceModel, ndf
from fitter.models.pair import Half


def density(model: ReflectanceModel) -> list[str]:
    """``lobe``, D times the masking term ``v``."""
    spec = model.spec
    if spec.ndf == "ggx":
        aniso = spec.anisotropic
        first = parts.turn("h") if aniso else []
        across = (
            "hu*hu/(alpha_x*alpha_x) + hv*hv/(alpha_y*alpha_y)" if aniso else "(hx*hx + hy*hy)/(alpha*alpha)"
        )
        area = "alpha_x*alpha_y" if aniso else "alpha*alpha"
        return [
            *first, f"ratio = h2 / (hz*hz + {across})", f"lobe = ratio*ratio / (PI*{area}) * v",
        ]  # fmt: skip
    tangent = ["tan2 = (hx/hz)*(hx/hz) + (hy/hz)*(hy/hz)"]
    note = "# The root of the exponential, twice: it underflows only where the product has."
    if spec.ndf == "blinn":
        return [
            *tangent, note, "root = exp(-0.25*n*log1p(tan2))",
            "lobe = root * (root * ((n + 2.0)/(2.0*PI)) * v)",
        ]  # fmt: skip
    if spec.ndf == "gaussian":
        return [
            *tangent, "theta = atan2(sqrt(tan2), 1.0)", note, "root = exp(-0.5*theta*theta/(s*s))",
            "lobe = root * (root * scale * v)",
        ]  # fmt: skip
    if spec.ndf != "beckmann":
        raise SpecError(
            f"there is no source of the distribution {spec.ndf!r}", code="export-no-source", parameter="to",
            remedy="export the model as a table",
        )  # fmt: skip
    return [
        *parts.slopes(spec.anisotropic), *tangent, note, "root = exp(-0.5*slope2)",
        "lobe = root * (root * ((1.0 + tan2)*(1.0 + tan2) / (PI*area)) * v)",
    ]  # fmt: skip


def constants(model: ReflectanceModel) -> list[Argument]:
    """What the density needs beside the parameters: the norm of the Gaussian of angle."""
    if model.spec.ndf != "gaussian":
        return []
    up = Half(jnp.zeros(()), jnp.zeros(()), jnp.full((), 2.0), jnp.full((), 4.0))
    peak = np.array([float(d.density(up)) for d in ndf.each(model.spec, model.values)])
    return [derived("scale", peak, "density of normals at the normal, 1/sr", len(model.channels))]


def masking(model: ReflectanceModel) -> tuple[list[str], list[Argument]]:
    """``v`` = G / (4 cos_i cos_o), and the arguments it needs beside the parameters."""
    spec = model.spec
    if spec.masking == "v_groove":
        return [
            "# Masking of V-grooves, over 4 cos_i cos_o.",
            "v = pick(4.0*hz*min(iz, oz) < h2, hz/(h2*max(iz, oz)), 0.25/(iz*oz))",
        ], []  # fmt: skip
    if spec.masking == "schlick_ggx":
        return [
            "k = 0.5*alpha",
            "v = 0.25 / ((iz*(1.0 - k) + k)*(oz*(1.0 - k) + k))",
        ], []  # fmt: skip
    if spec.masking == "rational":
        return [*_projected(model), *_rational(), "v = 0.25*gi*go"], []
    lines, arguments = _lambda(model)
    joint = {
        "smith": "v = 0.25 / (iz*oz + oz*li + iz*lo)",
        "smith_separable": "v = 0.25 / ((iz + li)*(oz + lo))",
    }[spec.masking or ""]
    return [*lines, "# Smith's masking, over 4 cos_i cos_o.", joint], arguments


def _projected(model: ReflectanceModel) -> list[str]:
    turn = ["c_psi_m = cos(psi)", "s_psi_m = sin(psi)"] if model.spec.anisotropic else []
    # The density turns the half vector with names of its own.
    return turn + [line.replace("c_psi", "c_psi_m").replace("s_psi", "s_psi_m") for line in parts.projected(
        model.spec.anisotropic
    )]  # fmt: skip


def _rational() -> list[str]:
    lines = ["# Walter's rational approximation of Smith's term of each direction, over its cosine."]
    for d in "io":
        lines += [
            f"p{d} = sqrt(max(p{d}2, 1.0e-37))",
            f"q{d} = pick({d}z >= 1.6*p{d}, 1.0, p{d})",
            f"a{d} = pick({d}z >= 1.6*p{d}, 1.0, {d}z)/q{d}",
            f"g{d} = pick({d}z >= 1.6*p{d}, 1.0/{d}z, "
            f"(3.535 + 2.181*a{d})/(q{d}*(1.0 + a{d}*(2.276 + 2.577*a{d}))))",
        ]
    return lines


def _lambda(model: ReflectanceModel) -> tuple[list[str], list[Argument]]:
    """``li``, ``lo``: Smith's Lambda times the cosine, of each direction."""
    spec = model.spec
    lines = ["# Smith's Lambda of each direction, times its cosine."]
    if spec.ndf == "ggx":
        lines += _projected(model)
        lines += [f"l{d} = 0.5*p{d}2 / (sqrt({d}z*{d}z + p{d}2) + {d}z)" for d in "io"]
        return lines, []
    if spec.ndf == "beckmann":
        lines += _projected(model)
        for d in "io":
            lines += [
                f"p{d} = sqrt(max(p{d}2, 1.0e-37))",
                f"a{d} = pick({d}z >= 6.0*p{d}, 6.0, {d}z/pick({d}z >= 6.0*p{d}, 1.0, p{d}))",
                f"l{d} = pick({d}z >= 6.0*p{d}, 0.0, "
                f"exp(-a{d}*a{d})*p{d}/(2.0*sqrt(PI)) - 0.5*{d}z*erfc(a{d}))",
            ]
        return lines, []
    return _series(model)


def _series(model: ReflectanceModel) -> tuple[list[str], list[Argument]]:
    """Lambda cos of Blinn's and the Gaussian distribution: Clenshaw's recurrence, written out."""
    count = len(model.channels)
    blinn = model.spec.ndf == "blinn"
    distributions = cast("list[ndf.Blinn | ndf.Gaussian]", ndf.each(model.spec, model.values))
    found = [d.lambda_series() for d in distributions]
    end = np.array([float(end) for end, _ in found])
    terms = np.stack([np.asarray(terms) for _, terms in found], axis=1)
    arguments = [derived("end", end, "where the series of Smith's term ends", count)]
    arguments += [
        derived(f"k{j}", term, f"its coefficient {j}", count) for j, term in enumerate(terms)
    ]  # fmt: skip
    lines = ["# Smith's Lambda of each direction, times its cosine: a Chebyshev series."]
    last = len(terms) - 1
    for d in "io":
        at = f"{d}z" if blinn else f"atan2({d}z, sqrt({d}x*{d}x + {d}y*{d}y))"
        lines += [f"at{d} = {at}", f"x{d} = 2.0*min(at{d}, end)/end - 1.0"]
        lines += [f"b{d}{last} = k{last}", f"b{d}{last - 1} = k{last - 1} + 2.0*x{d}*b{d}{last}"]
        lines += [
            f"b{d}{j} = k{j} + 2.0*x{d}*b{d}{j + 1} - b{d}{j + 2}" for j in range(last - 2, 0, -1)
        ]  # fmt: skip
        value = f"(k0 + x{d}*b{d}1 - b{d}2)"
        if blinn:
            value = f"exp(0.5*(n + 2.0)*log1p(-min({d}z*{d}z, 0.9999999)))*{value}"
        lines.append(f"l{d} = pick(at{d} < end, {value}, 0.0)")
    return lines, arguments
