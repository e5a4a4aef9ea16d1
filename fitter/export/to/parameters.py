"""The model as itself: its parameters with their uncertainties and where they come from, as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fitter._version import __version__
from fitter.documents import write_document
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject

KIND = "brdf-fitter/material"
#: What of a fit says where the parameters come from and how far to trust them.
_PROVENANCE = (
    "status", "message", "metrics", "uncertainty", "covariance", "table", "spec", "warnings", "versions",
)  # fmt: skip
CONVENTION = "f_r in 1/sr, without the cosine; angles in radians"


def write(subject: Subject, path: Path) -> Written:
    write_document(document(subject), path)
    return Written()


def document(subject: Subject) -> dict[str, Any]:
    """JSON-ready: the model, each parameter with u (k = 1), and the provenance."""
    assert subject.model is not None
    model, fit = subject.model, subject.fit
    parameters = {
        p.name: {
            "value": np.asarray(model.values[p.name]).tolist(), "unit": p.unit, "description": p.description,
            "standard_uncertainty": None, "degrees_of_freedom": None, "at_bound": None,
        }
        for p in model.table
    }  # fmt: skip
    provenance: dict[str, Any] = {"written_by": f"brdf-fitter {__version__}"}
    if fit is not None:
        for name, estimate in fit.parameters.items():
            parameters[name] |= estimate.to_dict()
        told = fit.to_dict()
        provenance |= {key: told[key] for key in _PROVENANCE}
    return {
        "kind": KIND, "version": 1, "name": subject.name, "convention": CONVENTION,
        "channels": [{"name": c.name, "wavelength_nm": c.wavelength_nm} for c in subject.channels],
        "model": model.to_dict(), "parameters": parameters, "provenance": provenance,
    }  # fmt: skip


TARGET = Target(
    "json", "the parameters with their uncertainties and provenance", True, False, ".json", CONVENTION, write,
    "application/json",
)  # fmt: skip
