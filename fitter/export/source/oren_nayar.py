"""Oren and Nayar's model, in four forms: see :mod:`fitter.models.oren_nayar`."""

from __future__ import annotations

from fitter.export.source.formula import Formula, arguments_of
from fitter.models import ReflectanceModel

#: 1/2 - 2/(3 pi) and 2/3 - 28/(15 pi).
_K1, _K2 = "(0.5 - 2.0/(3.0*PI))", "(2.0/3.0 - 28.0/(15.0*PI))"


def formula(model: ReflectanceModel) -> Formula:
    written = {"qualitative": _qualitative, "full": _full, "fujii": _fujii, "eon": _eon}
    lines, result = written[model.spec.variant or "qualitative"]()
    return Formula(model.channels, tuple(arguments_of(model)), tuple(lines), result)


def _qualitative() -> tuple[list[str], str]:
    lines = [
        "s2 = sigma*sigma",
        "inner = ix*ox + iy*oy",
        "forward = max(inner, 0.0) / max(iz, oz)",
        "level = 1.0 - 0.5*s2/(s2 + 0.33)",
    ]
    return lines, "rho / PI * (level + 0.45*s2/(s2 + 0.09)*forward)"


def _fujii() -> tuple[list[str], str]:
    lines = [
        "inner = ix*ox + iy*oy",
        "t = pick(inner > 0.0, max(iz, oz), 1.0)",
        f"scale = 1.0 / (1.0 + {_K1}*sigma)",
        "single = scale / PI * (1.0 + sigma*inner/t)",
    ]
    return lines, "rho*single"


def _eon() -> tuple[list[str], str]:
    lines, _ = _fujii()
    for d in "io":
        lines += [
            f"# The light that one reflection loses, of w{d}, over its scale and sigma: near the normal,",
            "# then elsewhere by complements, where every term is small at grazing.",
            f"s{d} = sqrt({d}x*{d}x + {d}y*{d}y)",
            f"near{d} = pick({d}z > 0.5, {d}z, 1.0)",
            f"g{d} = s{d}*(atan2(s{d}, near{d}) - s{d}*near{d})"
            f" + 2.0/3.0*s{d}*s{d}*s{d}*(1.0/(1.0 + near{d}) - s{d})/near{d}",
            f"mu{d} = pick({d}z > 0.5, 0.5, {d}z)",
            f"t{d} = pick({d}z > 0.5, 1.0, s{d})",
            f"rest{d} = PI*{_K1}*mu{d}*mu{d} + t{d}*(1.0 + t{d})*(atan2(mu{d}, t{d}) + t{d}*mu{d})"
            f" - 2.0/3.0*mu{d}*t{d}*(1.0 + t{d} + t{d}*t{d})",
            f"missing{d} = pick({d}z > 0.5, {_K1} - g{d}/PI, rest{d}/(PI*(1.0 + t{d})))",
        ]
    lines += [
        f"average = scale*(1.0 + {_K2}*sigma)",
        f"lost = scale*({_K1} - {_K2})*sigma",
        "rho_ms = rho*rho*average / (1.0 - rho*lost)",
        f"several = sigma*scale / (PI*({_K1} - {_K2})) * missingi*missingo",
    ]
    return lines, "rho*single + rho_ms*several"


def _full() -> tuple[list[str], str]:
    lines = [
        "s2 = sigma*sigma",
        "q = s2/(s2 + 0.09)",
        "si = sqrt(ix*ix + iy*iy)",
        "so = sqrt(ox*ox + oy*oy)",
        "# a is the larger of the two polar angles, b the smaller: told apart by their tangents.",
        "tilt = si*oz - so*iz",
        "sa = pick(tilt > 0.0, si, so)",
        "sb = pick(tilt > 0.0, so, si)",
        "ca = pick(tilt > 0.0, iz, oz)",
        "cb = pick(tilt > 0.0, oz, iz)",
        "a = atan2(sa, ca)",
        "b = atan2(sb, cb)",
        "inner = ix*ox + iy*oy",
        "rest = 2.0/PI*atan2(cb, sb)",
        "b3 = 2.0*b/PI",
        "lack = pick(cb < 0.5, rest*(3.0 - rest*(3.0 - rest)) - ca*ca/(1.0 + sa), sa - b3*b3*b3)",
        "plane = 0.45*q*inner*pick(inner < 0.0, lack/pick(sa > 0.0, sa, 1.0), 1.0)/cb",
        "# Cosine and sine of the difference of azimuths, both 0 where one is undefined.",
        "ii = pick(si > 0.0, si, 1.0)",
        "oo = pick(so > 0.0, so, 1.0)",
        "cos_d = (ix/ii)*(ox/oo) + (iy/ii)*(oy/oo)",
        "sin_d = (ix/ii)*(oy/oo) - (iy/ii)*(ox/oo)",
        "turned = sin_d*sin_d/(1.0 + max(cos_d, -cos_d))",
        "ab = 4.0*a*b/(PI*PI)",
        "across = turned*0.125*q*ab*ab*(sa + sb)/(ca + cb)",
        "level = 1.0 - 0.5*s2/(s2 + 0.33)",
        "bounce = 0.17*s2/(s2 + 0.13)*(1.0 - cos_d*b3*b3)",
    ]
    return lines, "rho / PI * (level + plane + across + rho*bounce)"
