"""The nonlinear regression problems of NIST's Statistical Reference Datasets.

National Institute of Standards and Technology, Statistical Engineering Division, "StRD: Nonlinear Least
Squares Regression", https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml. ``problems.json`` holds of each
its level of difficulty, both starting points, the certified parameters (to 11 digits), their standard
deviations and residual sum of squares, and the data as published; here are its models.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Model = Callable[..., NDArray[np.complex128]]


def _gauss(x, b1, b2, b3, b4, b5, b6, b7, b8):
    return b1 * np.exp(-b2 * x) + b3 * np.exp(-(((x - b4) / b5) ** 2)) + b6 * np.exp(-(((x - b7) / b8) ** 2))


def _lanczos(x, b1, b2, b3, b4, b5, b6):
    return b1 * np.exp(-b2 * x) + b3 * np.exp(-b4 * x) + b5 * np.exp(-b6 * x)


def _chwirut(x, b1, b2, b3):
    return np.exp(-b1 * x) / (b2 + b3 * x)


def _cubic(x, b1, b2, b3, b4, b5, b6, b7):
    return (b1 + b2 * x + b3 * x**2 + b4 * x**3) / (1 + b5 * x + b6 * x**2 + b7 * x**3)


def _wave(x, period, along, across):
    return along * np.cos(2 * np.pi * x / period) + across * np.sin(2 * np.pi * x / period)


MODELS: dict[str, Model] = {
    "Misra1a": lambda x, b1, b2: b1 * (1 - np.exp(-b2 * x)),
    "Misra1b": lambda x, b1, b2: b1 * (1 - (1 + b2 * x / 2) ** -2),
    "Misra1c": lambda x, b1, b2: b1 * (1 - (1 + 2 * b2 * x) ** -0.5),
    "Misra1d": lambda x, b1, b2: b1 * b2 * x / (1 + b2 * x),
    "Chwirut1": _chwirut, "Chwirut2": _chwirut,
    "Lanczos1": _lanczos, "Lanczos2": _lanczos, "Lanczos3": _lanczos,
    "Gauss1": _gauss, "Gauss2": _gauss, "Gauss3": _gauss,
    "DanWood": lambda x, b1, b2: b1 * x**b2,
    "Kirby2": lambda x, b1, b2, b3, b4, b5: (b1 + b2 * x + b3 * x**2) / (1 + b4 * x + b5 * x**2),
    "Hahn1": _cubic, "Thurber": _cubic,
    # Of the logarithm of the response.
    "Nelson": lambda x1, x2, b1, b2, b3: b1 - b2 * x1 * np.exp(-b3 * x2),
    "MGH17": lambda x, b1, b2, b3, b4, b5: b1 + b2 * np.exp(-x * b4) + b3 * np.exp(-x * b5),
    "Roszman1": lambda x, b1, b2, b3, b4: b1 - b2 * x - np.arctan(b3 / (x - b4)) / np.pi,
    "ENSO": lambda x, b1, b2, b3, b4, b5, b6, b7, b8, b9: (
        b1 + _wave(x, 12, b2, b3) + _wave(x, b4, b5, b6) + _wave(x, b7, b8, b9)
    ),
    "MGH09": lambda x, b1, b2, b3, b4: b1 * (x**2 + x * b2) / (x**2 + x * b3 + b4),
    "BoxBOD": lambda x, b1, b2: b1 * (1 - np.exp(-b2 * x)),
    "Rat42": lambda x, b1, b2, b3: b1 / (1 + np.exp(b2 - b3 * x)),
    "MGH10": lambda x, b1, b2, b3: b1 * np.exp(b2 / (x + b3)),
    "Eckerle4": lambda x, b1, b2, b3: (b1 / b2) * np.exp(-0.5 * ((x - b3) / b2) ** 2),
    "Rat43": lambda x, b1, b2, b3, b4: b1 / (1 + np.exp(b2 - b3 * x)) ** (1 / b4),
    "Bennett5": lambda x, b1, b2, b3: b1 * (b2 + x) ** (-1 / b3),
}  # fmt: skip


class Sums(NamedTuple):
    """The normal equations of one vector."""

    matrix: FloatArray
    rhs: FloatArray
    objective: float


@dataclass(frozen=True)
class Problem:
    """starts (2, P); certified, deviations (P,); rss; y (n,), x (X, n)."""

    name: str
    level: str
    starts: FloatArray
    certified: FloatArray
    deviations: FloatArray
    rss: float
    y: FloatArray
    x: FloatArray

    def residuals(self, b: FloatArray) -> FloatArray:
        """Model less response (n,)."""
        response = np.log(self.y) if self.name == "Nelson" else self.y
        return MODELS[self.name](*self.x, *b) - response

    def equations(self, b: FloatArray) -> Sums:
        """Derivatives by a complex step are exact to rounding, and need no second formula."""
        with np.errstate(all="ignore"):  # A trial far off may overflow: its objective is not finite then.
            r = self.residuals(b)
            h = 1e-20 * np.maximum(np.abs(b), 1e-20)
            stepped = b + 1j * np.diag(h)
            jacobian = np.stack(
                [MODELS[self.name](*self.x, *row).imag / step for row, step in zip(stepped, h, strict=True)]
            )
            return Sums(jacobian @ jacobian.T, -jacobian @ r, float(r @ r))


def _read(row: dict) -> Problem:
    arrays = {
        name: np.asarray(row[name]) for name in ("starts", "certified", "deviations", "y", "x")
    }  # fmt: skip
    return Problem(name=row["name"], level=row["level"], rss=row["rss"], **arrays)


PROBLEMS = tuple(_read(row) for row in json.loads(Path(__file__).with_name("problems.json").read_text()))
