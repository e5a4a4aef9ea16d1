"""Averages of a subject over patches of both hemispheres, and Radiance's tools that make BSDF XML of them.

The frame of such a file is Radiance's: what is exported is the side of +z, "Reflection Back" in the file (its
front is the outside). The incident direction of a patch is that of the light's travel.
"""

from __future__ import annotations

import importlib
import re
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter._version import __version__
from fitter.errors import FitError, SpecError
from fitter.export.fidelity import compared_pairs
from fitter.export.subject import Subject, plain
from fitter.formats.output import write_aside
from fitter.formats.registry import Loss
from fitter.formats.tensor_tree import disk_from_square

FloatArray = NDArray[np.float64]
#: Pairs of patches (M, ...) and places in them (M, 4), even in [0, 1), two incident, two outgoing -> wi, wo.
Place = Callable[[NDArray[np.intp], FloatArray], tuple[FloatArray, FloatArray]]

#: f_r (M, C) of wi, wo (M, 3), and where it was not measured.
There = Callable[[FloatArray, FloatArray], tuple[FloatArray, NDArray[np.bool_]]]

_CHUNK = 1 << 19
#: Incidences in degrees that reflectances are compared at, and points of the hemisphere on a side.
_THETA, _PHI, _ACROSS = (0, 20, 45, 60, 70), (30, 100), 256
#: Seconds that Radiance's checkBSDF gets; it takes a few.
LONGEST = 120.0


def radiance() -> Any:
    """Radiance's tools, from the wheel pyradiance. Raises SpecError where it is not installed."""
    try:
        return importlib.import_module("pyradiance")
    except ImportError as error:
        raise SpecError(
            "this export is made by Radiance's own tools, and pyradiance is not installed",
            code="export-needs-package", parameter="to", remedy="pip install brdf-fitter[renderers]",
        ) from error  # fmt: skip


class Averages:
    """Mean f_r of the one channel over pairs of patches, and what was met on the way."""

    def __init__(self, subject: Subject) -> None:
        self._subject = subject
        self._asked, self._outside, self._negative = 0, 0, 0

    def over(self, cells: NDArray[np.intp], place: Place, points: int) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (n,) among ``points`` pairs of directions in each pair of patches
        (n, ...), the same in each: of Sobol's sequence, and those with the directions exchanged, so that what
        is reciprocal stays so."""
        qmc: Any = importlib.import_module("scipy.stats.qmc")
        half = qmc.Sobol(4, scramble=True, seed=1).random(points // 2)
        inner = np.concatenate([half, 1 - half[:, [2, 3, 0, 1]]])
        mean, spread = np.zeros(len(cells)), np.zeros(len(cells))
        step = max(1, _CHUNK // points)
        for start in range(0, len(cells), step):
            some = cells[start : start + step]
            wi, wo = place(np.repeat(some, points, axis=0), np.tile(inner, (len(some), 1)))
            value = self._value(wi, wo).reshape(len(some), points)
            mean[start : start + step] = value.mean(axis=1)
            spread[start : start + step] = value.std(axis=1)
        return mean, spread

    def _value(self, wi: FloatArray, wo: FloatArray) -> FloatArray:
        above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        value = np.zeros(len(wi))
        found, beyond = self._subject.evaluate(wi[above], wo[above])
        value[above] = np.where(np.isfinite(found[:, 0]), np.maximum(found[:, 0], 0.0), 0.0)
        self._asked += len(found)
        self._outside += int(beyond.sum())
        self._negative += int((found[:, 0] < 0).sum())
        return value

    def note(self, what: str) -> Loss:
        """``what`` the averages are over, and how much was not measured."""
        said = f"Patches are averages over {what}, scaled to each incidence's reflectance where lobes are"
        if self._outside:
            share = self._outside / self._asked
            said += f"; {share:.1%} of them lie outside what was measured, where the nearest is taken"
        if self._negative:
            said += f"; {self._negative / self._asked:.2%} were negative and count as 0"
        return Loss("not-covered" if self._outside else "averaged", f"{said}.")


def wrapped(subject: Subject, path: Path, basis: str, data: bytes) -> None:
    """The XML that Radiance's wrapBSDF makes of a component's data, written aside and renamed."""
    tools = radiance()
    with tempfile.TemporaryDirectory(prefix="brdf-fitter-") as folder:
        component = Path(folder) / "component.dat"
        component.write_bytes(data)
        # wrapBSDF puts fields apart by ; and =.
        name = re.sub(r"[;=\"'&]", " ", plain(subject.name))[:80]
        comment = "f_r in 1/sr, without the cosine, as averages over patches. " + re.sub(
            r"[&]", "+", " ".join(subject.comments())
        )
        wrapper = tools.WrapBSDF(
            basis=basis, unit="meter", comment=comment, n=name, m=f"brdf-fitter {__version__}", t=0, w=0, h=0
        )
        made: bytes = wrapper.add_visible(rb=str(component))()
    if not made.strip():
        raise FitError("Radiance's wrapBSDF wrote nothing", code="radiance-failed")
    write_aside(path, [made])


def reflectance(subject: Subject, there: There) -> Loss:
    """How far the directional-hemispherical reflectance of the file is from the source's, up to 70 deg."""
    theta, phi = (c.reshape(-1) for c in np.meshgrid(np.deg2rad(_THETA), np.deg2rad(_PHI)))
    wi = directions.vector_from_spherical(theta, phi)
    across = (np.arange(_ACROSS) + 0.5) / _ACROSS
    square = np.stack([c.reshape(-1) for c in np.meshgrid(across, across)], axis=1)
    disk = disk_from_square(square)
    # Even over the disk is even in projected solid angle.
    wo = np.concatenate([disk, np.sqrt(1.0 - (disk * disk).sum(axis=1))[:, None]], axis=1)

    def whole(function: There) -> FloatArray:
        return np.array([
            np.pi * np.maximum(function(np.tile(w, (len(wo), 1)), wo)[0][:, 0], 0.0).mean() for w in wi
        ])  # fmt: skip

    found = whole(there)
    source = whole(subject.evaluate) if subject.model is None else np.asarray(subject.model.albedo(wi))[:, 0]
    change = np.abs(found - source) / np.maximum(source, np.finfo(float).tiny)
    most = int(change.argmax())
    return Loss(
        "reflectance",
        f"The hemispherical reflectance in the file differs from the source's by {change.mean():.1%} on "
        f"average of {len(wi)} incidences to {_THETA[-1]} deg, and by {change[most]:.1%} at most, at "
        f"{np.rad2deg(theta[most]):.0f} deg.",
    )


def reciprocity(subject: Subject, path: Path) -> Loss:
    """How far exchanging the directions changes f: of the source, and of the file as checkBSDF has it.

    Raises FitError where checkBSDF does not take the file.
    """
    tools = radiance()
    program = Path(str(tools.__file__)).parent / "bin" / "checkBSDF"
    try:
        done = subprocess.run([program, path], capture_output=True, text=True, check=False, timeout=LONGEST)
    except subprocess.TimeoutExpired as error:
        raise FitError(
            f"Radiance's checkBSDF does not end within {LONGEST:g} s", code="radiance-failed", file=str(path),
            remedy="try again, or export as another format (--to rgl)",
        ) from error  # fmt: skip
    after = re.search(r"Reciprocity Error.*?Refl\s+([\d.eE+-]+)\s+([\d.eE+-]+)", done.stdout, re.DOTALL)
    if done.returncode != 0 or after is None:
        raise FitError(
            f"Radiance's checkBSDF does not take the file: {(done.stderr or done.stdout)[-300:]}",
            code="radiance-failed", file=str(path),
        )  # fmt: skip
    wi, wo = (w[::8] for w in compared_pairs(subject))
    one, other = subject.evaluate(wi, wo)[0][:, 0], subject.evaluate(wo, wi)[0][:, 0]
    total = one + other
    before = float(np.mean(2 * np.abs(one - other)[total > 0] / total[total > 0]))
    return Loss(
        "reciprocity",
        f"Exchanging the directions changes the source by {before:.2%} on average, and the file by "
        f"{float(after[2]):g} % as Radiance's checkBSDF finds.",
    )
