"""Ward's model, in its three normalisations: see :mod:`fitter.models.ward`."""

from __future__ import annotations

from fitter.export.source import parts
from fitter.export.source.formula import Formula, arguments_of
from fitter.models import ReflectanceModel


def formula(model: ReflectanceModel) -> Formula:
    spec = model.spec
    lines = [
        *parts.HALF, *parts.slopes(spec.anisotropic),
        "# The root of the exponential, twice: it underflows only where the product has.",
        "root = exp(-0.5*slope2)",
    ]  # fmt: skip
    if spec.variant == "bounded":
        lines += [
            "steep2 = 1.0 / (hz*hz)",
            "lobe = root * (root * (h2*steep2) * (steep2 / (PI*area)))",
        ]
    elif spec.variant == "duer":
        lines.append("lobe = root * (root / (4.0*PI*area*iz*oz))")
    else:
        lines.append("lobe = root * (root / (4.0*PI*area*sqrt(iz*oz)))")
    result = parts.with_diffuse(spec.diffuse, "ks*lobe")
    return Formula(model.channels, tuple(arguments_of(model)), tuple(lines), result)
