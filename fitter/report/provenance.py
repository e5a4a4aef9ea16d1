"""Provenance: versions, specification, hashes, seeds, and the command that makes the result again."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from fitter._version import __version__
from fitter.report.fitted import Fitted
from fitter.versions import installed

if TYPE_CHECKING:
    from fitter.fitting.result import FitResult
    from fitter.posterior.result import Posterior

DRAWN_WITH = ("numpy", "matplotlib", "corner", "jinja2")


def section(fitted: Fitted, posterior: Posterior | None, seed: int) -> dict[str, Any]:
    """JSON-ready."""
    fit = fitted.fit
    return {
        "versions": dict(fit.versions),
        "report_versions": {
            "brdf-fitter": __version__, **{name: installed(name) for name in DRAWN_WITH}
        },
        "fit_spec": fit.spec.model_dump(mode="json"),
        "posterior_spec": None if posterior is None else posterior.spec.model_dump(mode="json"),
        "table_hash": fitted.table.hash,
        "fitted_table_hash": fit.table.get("hash"),
        "file_sha256": fitted.table.metadata.sha256,
        "source": fit.table.get("source"),
        "seeds": {
            "fit": fit.spec.seed,
            "posterior": None if posterior is None else posterior.spec.seed,
            "report": seed,
        },
        "commands": commands(fit, posterior),
    }  # fmt: skip


def commands(fit: FitResult, posterior: Posterior | None) -> list[str]:
    """What to type to make the result again; FILE stands for a table whose file is not known."""
    spec = fit.spec
    source: Mapping[str, Any] = fit.table.get("source") or {}
    file = PurePath(str(source["path"])).name if source.get("path") else "FILE"
    words = ["brdf-fitter", "fit", file, "--model", spec.model.name]
    metric = spec.metric or fit.table.get("metric")
    words += ["--metric", str(metric)] if metric else []
    words += ["--weighting", spec.weighting] if spec.weighting is not None else []
    words += ["--solver", spec.solver] if spec.solver != "optimistix" else []
    for name, value in spec.fixed.items():
        words += ["--fixed", f"{name}={value!r}"]
    for name, (low, high) in spec.bounds.items():
        words += ["--bounds", f"{name}={low!r},{high!r}"]
    select = spec.select
    words += ["--theta-i-max", f"{select.theta_i_max_deg!r}"] if select.theta_i_max_deg is not None else []
    words += ["--theta-o-max", f"{select.theta_o_max_deg!r}"] if select.theta_o_max_deg is not None else []
    words += ["--channels", ",".join(select.channels)] if select.channels else []
    words += ["--starts", str(spec.starts)] if spec.starts is not None else []
    words += ["--polish", spec.polish] if spec.polish != "full" else []
    words += ["--subset", str(spec.subset), "--seed", str(spec.seed)]
    compressed = fit.table.get("compressed")
    words += ["--compress", f"{compressed['tolerance']!r}"] if compressed else []
    options: Mapping[str, Any] = source.get("options") or {}
    for name, value in options.items():
        if isinstance(value, Mapping):
            for key, meaning in value.items():
                words += ["--column", f"{key}={meaning}"]
        elif value is not None:
            words += [f"--{name}", str(value)]
    found = [shlex.join([*words, "--out", "DIR"])]
    if posterior is not None:
        result = f"DIR/{spec.model.name.replace(':', '-')}.json"
        found.append(shlex.join(["brdf-fitter", "posterior", result, "--seed", str(posterior.spec.seed)]))
    return found
