"""RGL tensor files, for Mitsuba 3 and pbrt-v4: a model exactly at the samples, a table interpolated there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.export import table_layout
from fitter.export.fidelity import of_function
from fitter.export.half_vectors import HalfVectors
from fitter.export.registry import Target, Written
from fitter.export.subject import Subject
from fitter.formats import rgl_writer
from fitter.formats.output import refuse_in_plane, write_aside
from fitter.formats.registry import Loss
from fitter.formats.rgl import adaptive_of
from fitter.formats.source import Source
from fitter.formats.tensor_file import fields as fields_of
from fitter.formats.tensor_file import tensor_bytes
from fitter.sampling.adaptive import AdaptiveInterpolant
from fitter.sampling.parameterisation import Adaptive
from fitter.table import Table

FloatArray = NDArray[np.float64]


def write(subject: Subject, path: Path) -> Written:
    if subject.table is not None:
        return _write_table(subject, subject.table, path)
    return _write_model(subject, path)


def _write_table(subject: Subject, table: Table, path: Path) -> Written:
    between = table.between
    if (
        isinstance(between, AdaptiveInterpolant) and between.quantity == "ccbrdf"
        and between.adaptive.jacobian and np.isfinite(between.adaptive.data).all()
    ):  # fmt: skip
        return _write_own(subject, table, between.adaptive, path)
    if table.symmetry != "isotropic" or rgl_writer.order_of(table.channels) is None:
        return Written((*rgl_writer.write_rgl(table, path), _fidelity(subject, path)))
    refuse_in_plane(table, "an RGL file")
    chosen = table_layout.chosen(subject)
    if chosen is None:
        return Written((*rgl_writer.write_rgl(table, path), _fidelity(subject, path)))
    layout, error = chosen
    losses = rgl_writer.write_rgl(table, path, layout)
    said = (
        f"{layout.theta_i.size} incidences of {layout.steps} x {layout.steps} samples each, "
        f"{path.stat().st_size / 1e6:.1f} MB: expected to be within {error:.2%} of the table for 95 % of "
        "directions, half even over what was measured, half by f_r cos(theta_o)."
    )
    if error > table_layout.STATED:
        said += f" No layout of this size comes to {table_layout.STATED:.0%}."
    return Written((Loss("resolution", said), *losses, _fidelity(subject, path)))


def _write_own(subject: Subject, table: Table, adaptive: Adaptive, path: Path) -> Written:
    """A table that was read from such a file, with the samples and places it had there."""
    order = rgl_writer.order_of(table.channels)
    assert order is not None
    above = np.stack([adaptive.samples(node)[0][:, 2] > 0 for node in range(len(adaptive.data))])
    data = adaptive.data[:, order].astype(np.float32)
    about = rgl_writer.fields(
        table.metadata.name, table.channels, replace(adaptive, data=data), order, None, above
    )
    write_aside(path, tensor_bytes(about))
    said = Loss("exact", "The table comes from such a file: its samples are written as they were.")
    return Written((said, _fidelity(subject, path), *rgl_writer.repeated(order)))


def _write_model(subject: Subject, path: Path) -> Written:
    order = rgl_writer.order_of(subject.channels)
    if order is None:
        raise SpecError(
            f"an RGL file holds RGB or a spectrum, and the model has {len(subject.channels)} channels that "
            "don't have a wavelength each",
            code="export-channels", parameter="channels", remedy="choose one or three with --channels",
        )  # fmt: skip
    layout = HalfVectors(subject)
    adaptive, drawn, above = layout.sampled(layout.chosen())
    stored = replace(adaptive, data=adaptive.data[:, order])
    about = " ".join([subject.name, *subject.comments(), f"{TARGET.convention}."])
    fields = rgl_writer.fields(about, subject.channels, stored, order, None, above, drawn)
    write_aside(path, tensor_bytes(fields))
    angles, azimuths = len(stored.theta_i), len(stored.phi_i)
    shape = f"{angles} incident angles, {azimuths} azimuths" if azimuths > 1 else f"{angles} incidences"
    size = path.stat().st_size / 1e6
    said = f"{shape} of {stored.data.shape[-1]} x {stored.data.shape[-1]} samples each, {size:.1f} MB."
    return Written((Loss("resolution", said), _fidelity(subject, path), *rgl_writer.repeated(order)))


def _fidelity(subject: Subject, path: Path) -> Loss:
    """Of the file's own function, which is that of renderers."""
    source = Source(path)
    adaptive, _ = adaptive_of(source, fields_of(source))
    order = rgl_writer.order_of(subject.channels)
    assert order is not None
    own = [order.index(k) for k in range(len(subject.channels))]

    def there(wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        return adaptive.evaluate(wi, wo)[:, own] / wo[:, 2:], np.zeros(len(wi), bool)

    return of_function(subject, there)


TARGET = Target(
    "rgl", "RGL adaptive tensor file, for Mitsuba 3 (measured) and pbrt-v4", True, True, ".bsdf",
    "f_r cos(theta_o) in 1/sr, as Mitsuba's and pbrt's readers expect it", write,
)  # fmt: skip
