"""RGL tensor files, for Mitsuba 3 and pbrt-v4: a model exactly at the samples, a table interpolated there."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fitter.errors import SpecError
from fitter.export.fidelity import fidelity
from fitter.export.lobe import lobe_of
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject
from fitter.formats import rgl_writer
from fitter.formats.adaptive import Adaptive
from fitter.formats.output import write_aside
from fitter.formats.registry import Loss
from fitter.formats.tensor_file import tensor_bytes

#: Incidences and samples of each on either axis, with one azimuth and with several. Even incidences: what the
#: lobe does near grazing is no steeper than elsewhere in the format's own coordinates.
_ISOTROPIC, _ANISOTROPIC = (61, 96), (21, 48)
#: Azimuths of half a turn, the rest being its image: the four families have that symmetry.
_AZIMUTHS = 25
#: Where incidences end, degrees.
_LAST = 89.9


def write(subject: Subject, path: Path) -> Written:
    if subject.table is not None:
        return Written((*rgl_writer.write_rgl(subject.table, path), fidelity(subject, path)))
    return _write_model(subject, path)


def _write_model(subject: Subject, path: Path) -> Written:
    count = len(subject.channels)
    spectral = all(channel.wavelength_nm is not None for channel in subject.channels)
    if not spectral and count not in (1, 3):
        raise SpecError(
            f"an RGL file holds RGB or a spectrum, and the model has {count} channels without wavelengths",
            code="export-channels", parameter="channels", remedy="choose one or three with --channels",
        )  # fmt: skip
    order = list(range(count)) if spectral or count == 3 else [0, 0, 0]
    if spectral:
        order.sort(key=lambda k: subject.channels[k].wavelength_nm or 0.0)
    isotropic = subject.symmetry == "isotropic"
    angles, steps = _ISOTROPIC if isotropic else _ANISOTROPIC
    theta_i = np.deg2rad(np.linspace(0.0, _LAST, angles)).astype(np.float32).astype(np.float64)
    phi_i = np.zeros(1)
    if not isotropic:
        phi_i = np.linspace(-np.pi, 0.0, _AZIMUTHS).astype(np.float32).astype(np.float64)
    bare = rgl_writer.parameterisation(theta_i, phi_i, lobe_of(subject), steps)
    data, measured, above = rgl_writer.sampled(subject.evaluate, count, bare)
    adaptive = Adaptive(bare.theta_i, bare.phi_i, bare.ndf, bare.sigma, bare.vndf, data[:, order])
    fields = rgl_writer.fields(
        " ".join([subject.name, *subject.comments()]), subject.channels, adaptive, order, measured, above
    )
    write_aside(path, tensor_bytes(fields))
    notes = [fidelity(subject, path)]
    if order == [0, 0, 0]:
        notes.append(Loss("channels", "The one channel is there three times, as R, G and B."))
    return Written(tuple(notes))


TARGET = Target(
    "rgl", "RGL adaptive tensor file, for Mitsuba 3 (measured) and pbrt-v4", True, True, ".bsdf",
    "f_r cos(theta_o) in 1/sr, as Mitsuba's and pbrt's readers expect it", write,
)  # fmt: skip
