"""Writing RGL tensor files: a table interpolated where the samples of the adaptive parameterisation lie.

Where samples lie is decided by a distribution of normals. Its makers measure it by retro-reflection; here it
is a mixture of isotropic GGX distributions (B. Walter et al. 2007), the narrowest as wide as the table's own
lobe, whose projected area is known in closed form. It need not be right: the data make up for what it says
wrongly, sample by sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.formats.output import one_line, refuse_in_plane, unwritable, write_aside
from fitter.formats.registry import Loss
from fitter.formats.tensor_file import tensor_bytes
from fitter.metadata import Channel
from fitter.sampling.parameterisation import Adaptive
from fitter.table import Table

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

#: What is written: (wi, wo), each (M, 3) -> f_r (M, C), and (M,) where it was not measured.
Evaluate = Callable[[FloatArray, FloatArray], tuple[FloatArray, BoolArray]]


@dataclass(frozen=True)
class Lobe:
    """A GGX distribution of normals with roughness ``along`` the azimuth psi and ``across`` it."""

    along: float
    across: float
    psi: float = 0.0

    def density(self, m: FloatArray) -> FloatArray:
        """D of normals (..., 3), 1/sr."""
        x, y = self._turned(m)
        square = (x / self.along) ** 2 + (y / self.across) ** 2 + m[..., 2] ** 2
        return 1.0 / (np.pi * self.along * self.across * square**2)

    def projected_area(self, w: FloatArray) -> FloatArray:
        """Area of the microfacets seen from directions (..., 3), per area of the surface."""
        x, y = self._turned(w)
        z = w[..., 2]
        return 0.5 * (z + np.sqrt((self.along * x) ** 2 + (self.across * y) ** 2 + z * z))

    def _turned(self, w: FloatArray) -> tuple[FloatArray, FloatArray]:
        c, s = np.cos(self.psi), np.sin(self.psi)
        return c * w[..., 0] + s * w[..., 1], c * w[..., 1] - s * w[..., 0]


#: A field this program adds: 0 for samples that were not measured. Other readers look only for their own.
MEASURED = "measured"
#: Nodes of the distributions on each axis, as in the database.
_NODES = 128
#: Samples of an incidence on each axis (the database has 32) for up to so many incidences: from few to more,
#: until the file keeps to the table's own values.
_STEPS = ((16, (64, 128, 256)), (64, (64, 128)), (100, (64,)), (10**6, (32,)))
#: Where it does: the 95 % quantile of the relative difference.
_CLOSE = 0.01
#: How many of a table's own angles of incidence there may be, and how far apart nodes may lie (radians).
_ISOTROPIC, _ANISOTROPIC, _AZIMUTHS = (40, np.deg2rad(7.0)), (10, np.deg2rad(15.0)), (25, np.deg2rad(30.0))
#: Weights of linear R, G, B in the luminance that renderers draw from, those of the database's files.
_LUMINANCE = (0.212671, 0.715160, 0.072169)
#: Widths of the narrowest distribution: a mirror's samples would lie within the rounding of float32; and with
#: few about the mirror direction, where the mapping is steepest, smooth tables would be off there.
NARROWEST, WIDEST = 0.005, 0.2
#: So many of the table's samples are compared with what the file says of them.
_COMPARED = 4000


@dataclass(frozen=True)
class Layout:
    """Where the samples of a table lie: incidences (T,), (P,), the lobe's width, samples on each axis."""

    theta_i: FloatArray
    phi_i: FloatArray
    alpha: float
    steps: int


def write_rgl(table: Table, path: Path, layout: Layout | None = None) -> list[Loss]:
    """Write ``table`` interpolated at its incidences (or as many as it takes) and some between them.

    layout : default as coarse as keeps to the table's own values.

    Samples outside what was measured hold the interpolant's continuation, for renderers, and are marked in a
    field of their own, by which this program's reader knows them. Raises TableError for tables of one
    plane or of few directions, and for channels that are neither one, nor three, nor of a known wavelength
    each.
    """
    order = order_of(table.channels)
    if order is None:
        raise unwritable(
            table,
            f"an RGL file holds RGB or a spectrum, and the table has {len(table.channels)} channels that "
            "don't have a wavelength each", "use delimited text",
        )  # fmt: skip
    refuse_in_plane(table, "an RGL file")
    index = np.flatnonzero(table.mask)
    wi, wo = table.directions(index)
    if layout is None:
        alpha = lobe_width(wi, wo, table.value[index].mean(axis=1))
        theta_i, phi_i = incidences(table, wi)
        steps = next(steps for most, steps in _STEPS if theta_i.size * phi_i.size <= most)
    else:
        theta_i, phi_i, alpha, steps = layout.theta_i, layout.phi_i, layout.alpha, (layout.steps,)
    adaptive, measured, above = _interpolated(table, theta_i, phi_i, alpha, steps[0], order)
    half, most = _change(table, adaptive, order)
    for count in steps[1:]:
        if most <= _CLOSE:
            break
        adaptive, measured, above = _interpolated(table, theta_i, phi_i, alpha, count, order)
        half, most = _change(table, adaptive, order)
    said = (
        f"{int(measured.sum())} samples were interpolated; {int((above & ~measured).sum())} more lie outside "
        f"what was measured. The file's function differs from the table's own values by {half:.1%} in the "
        f"median, by {most:.1%} at most for 95 % of them."
    )
    about = fields(table.metadata.name, table.channels, adaptive, order, measured, above)
    write_aside(path, tensor_bytes(about))
    return [*repeated(order), Loss("resampled", said)]


def _interpolated(
    table: Table, theta_i: FloatArray, phi_i: FloatArray, alpha: float, steps: int, order: Sequence[int]
) -> tuple[Adaptive, BoolArray, BoolArray]:
    """The table at the samples of a file, which of them were measured, and which lie above the horizon."""
    bare = parameterisation(theta_i, phi_i, alpha, steps)
    data, measured, above = sampled(table.evaluate, len(table.channels), bare)
    if not measured.any():
        raise unwritable(
            table, "the table has too few directions for each incidence to interpolate between them",
            "use delimited text, or fit a model",
        )  # fmt: skip
    return (
        Adaptive(bare.theta_i, bare.phi_i, bare.ndf, bare.sigma, bare.vndf, data[:, list(order)]),
        measured,
        above,
    )


def lobe_width(wi: FloatArray, wo: FloatArray, level: FloatArray) -> float:
    """GGX's alpha of the lobe that samples (n,) show: from where 4 cos_i cos_o f falls to half its height.

    Of microfacets that product is D F G, D being a function of theta_h alone. Without a lobe alpha is 0.2.
    """
    theta_m, _ = directions.spherical_from_vector(wi + wo)
    product = np.maximum(level, 0.0) * 4 * wi[:, 2] * np.maximum(wo[:, 2], 0.0)
    place = np.minimum((np.sqrt(theta_m * (2 / np.pi)) * _NODES).astype(np.intp), _NODES - 1)
    count = np.bincount(place, minlength=_NODES)
    used = np.flatnonzero(count)
    mean = np.bincount(place, product, _NODES)[used] / count[used]
    top, base = float(mean.max()), float(np.median(mean))
    if len(used) < 3 or top <= 2 * base:
        return WIDEST
    peak = int(mean.argmax())
    below = np.flatnonzero(mean[peak:] < 0.5 * (top + base))
    u = (used[peak + int(below[0])] + 0.5) / _NODES
    half = np.tan(min(u * u, 0.99) * np.pi / 2)
    # D ~ 1 / (cos^4 (alpha^2 + tan^2)^2) is half its height where tan^2 is about (sqrt(2) - 1) alpha^2.
    return float(np.clip(half / np.sqrt(np.sqrt(2) - 1), NARROWEST, WIDEST))


def is_spectrum(channels: Sequence[Channel]) -> bool:
    """Whether channels are written as a spectrum: each has a wavelength of its own."""
    known = {channel.wavelength_nm for channel in channels}
    return None not in known and len(known) == len(channels)


def order_of(channels: Sequence[Channel]) -> list[int] | None:
    """Which channel of the source each of the file's is: a spectrum by wavelength, or R, G and B, which one
    channel is all of. None for other channels."""
    if is_spectrum(channels):
        return sorted(range(len(channels)), key=lambda k: channels[k].wavelength_nm or 0.0)
    return {1: [0, 0, 0], 3: [0, 1, 2]}.get(len(channels))


def repeated(order: Sequence[int]) -> list[Loss]:
    """What is to be said of a channel that stands for all of a file's."""
    if len(set(order)) == len(order):
        return []
    return [Loss("channels", "The one channel is there three times, as R, G and B.")]


def incidences(table: Table, wi: FloatArray, widest: float = _ISOTROPIC[1]) -> tuple[FloatArray, FloatArray]:
    """Incident angles (T,) and azimuths (P,): the table's own, and some between them, of isotropic surfaces
    no further than ``widest`` apart."""
    theta, phi = directions.spherical_from_vector(wi)
    if table.symmetry == "isotropic":
        return _nodes(theta, _ISOTROPIC[0], widest), np.zeros(1)
    # Both ends of a whole turn, as in the database.
    phi = np.concatenate([phi[theta > 1e-3], [-np.pi, np.pi]])
    return _nodes(theta, *_ANISOTROPIC), _nodes(phi, *_AZIMUTHS)


def _nodes(own: FloatArray, most: int, widest: float) -> FloatArray:
    """Increasing angles as float32 holds them.

    The format interpolates at a fixed place in the lobe, the table otherwise: close nodes keep to the table.
    """
    nodes = np.unique(np.round(own, 7))
    if len(nodes) > most:
        nodes = np.linspace(float(nodes[0]), float(nodes[-1]), most)
    between = [
        np.linspace(low, high, int(np.ceil((high - low) / widest - 1e-6)), endpoint=False)
        for low, high in pairwise(nodes)
    ]
    return np.unique(np.concatenate([*between, nodes[-1:]]).astype(np.float32)).astype(np.float64)


def mixture(lobe: Lobe, m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distribution of normals and projected area at directions (..., 3), of a lobe and wider ones."""
    # From the lobe's width to that of a hemisphere of facets: the diffuse part needs samples too.
    widths = [lobe, Lobe(lobe.along**0.5, lobe.across**0.5, lobe.psi), Lobe(1.0, 1.0)]
    ndf = np.mean([one.density(m) for one in widths], axis=0)
    # The projected area of the visible microfacets is cos / G1 with Smith's masking.
    return ndf, np.mean([one.projected_area(m) for one in widths], axis=0)


def parameterisation(theta_i: FloatArray, phi_i: FloatArray, alpha: float, steps: int) -> Adaptive:
    """Where the samples lie, without their values: for incident angles (T,) and azimuths (P,), ``steps``
    samples on each axis, about an isotropic lobe. All rounded to float32, as the file holds it."""
    u = np.linspace(0.0, 1.0, _NODES)
    theta = u * u * (np.pi / 2)
    m = directions.vector_from_spherical(theta, np.zeros((1, 1)))
    ndf, sigma = mixture(Lobe(alpha, alpha), m)
    phi, incidence = np.meshgrid(phi_i, theta_i, indexing="ij")
    c, s = np.cos(theta), np.sin(theta)
    across = np.cos((2 * u - 1) * np.pi - phi.reshape(-1, 1))
    tilt = incidence.reshape(-1, 1, 1)
    # wi . m on (incidence, phi_m, theta_m); the density of m over u has the Jacobian u sin(theta).
    vndf = ndf * np.maximum(np.sin(tilt) * across[:, :, None] * s + np.cos(tilt) * c, 0.0) * u * s
    vndf /= vndf.mean(axis=(1, 2), keepdims=True)
    # One row does where no azimuth differs; the format wants two.
    both = [np.tile(rows, (2, 1)).astype(np.float32) for rows in (ndf, sigma)]
    empty = np.zeros((incidence.size, 1, steps, steps), np.float32)
    return Adaptive(theta_i, phi_i, both[0], both[1], vndf.astype(np.float32), empty)


def sampled(evaluate: Evaluate, channels: int, bare: Adaptive) -> tuple[Float32Array, BoolArray, BoolArray]:
    """Data (P T, C, N, N), and (P T, N N) which samples were measured and which lie above the horizon.

    evaluate : (wi, wo), each (M, 3) -> f_r (M, C) in 1/sr, and (M,) where it was not measured.
    """
    steps = bare.data.shape[-1]
    data = np.zeros((len(bare.vndf), channels, steps, steps), np.float32)
    measured = np.zeros((len(data), steps * steps), bool)
    above = np.zeros_like(measured)
    for node, wi in enumerate(bare.nodes()):
        wo, factor = bare.samples(node)
        above[node] = wo[:, 2] > 0
        # Below the horizon it is 0: any other continuation shows above it where light leaves at grazing.
        mirrored = np.concatenate([wo[:, :2], np.abs(wo[:, 2:])], axis=1)
        value, outside = evaluate(np.broadcast_to(wi, wo.shape), mirrored)
        value = np.where(np.isfinite(value), value, 0.0) * (np.maximum(wo[:, 2:], 0.0) / factor[:, None])
        limit = float(np.finfo(np.float32).max)
        data[node] = np.clip(value, -limit, limit).T.reshape(data.shape[1:])
        measured[node] = above[node] & ~outside
    return data, measured, above


def _change(table: Table, adaptive: Adaptive, order: Sequence[int]) -> tuple[float, float]:
    """By how much the file's function differs from the table's own values: median and 95 % quantile."""
    index = np.flatnonzero(table.mask)
    index = index[np.unique(np.linspace(0, len(index) - 1, _COMPARED).astype(np.intp))]
    wi, wo = table.directions(index)
    above_it = wo[:, 2] > 0
    wi, wo, here = wi[above_it], wo[above_it], table.value[index[above_it]][:, list(order)]
    there = adaptive.evaluate(wi, wo) / wo[:, 2:]
    positive = here > 0
    change = np.abs(there - here)[positive] / here[positive]
    half, most = np.quantile(change, [0.5, 0.95]) if len(change) else (0.0, 0.0)
    return float(half), float(most)


def fields(
    name: str, channels: Sequence[Channel], adaptive: Adaptive, order: Sequence[int],
    measured: BoolArray | None, above: BoolArray, drawn: FloatArray | None = None,
) -> dict[str, NDArray[Any]]:  # fmt: skip
    """The file's fields.

    order : which channel of the source each of the file's is. measured : (P T, N N), None where all is.
    drawn : (P T, N N) by what samples are weighted where a renderer draws directions; None where their places
    are the visible normals', so that it draws by f cos with all weights 1.
    """
    shape, image = (len(adaptive.phi_i), len(adaptive.theta_i)), adaptive.data.shape[-2:]
    chosen: list[Channel] = [channels[k] for k in order]
    spectral = is_spectrum(channels)
    weights = np.full(len(order), 1 / len(order)) if spectral else np.array(_LUMINANCE)
    # A renderer scales it to unit integral: it can't be 0 everywhere.
    luminance = np.maximum(np.einsum("c,tcyx->tyx", weights, adaptive.data), 0.0)
    if drawn is not None:
        luminance *= drawn.reshape(luminance.shape)
    luminance += np.maximum(1e-6 * luminance.max(axis=(1, 2), keepdims=True), np.finfo(np.float32).tiny)
    text = one_line(name) or "without a name"
    fields: dict[str, NDArray[Any]] = {
        "version": np.array([1, 0], np.uint32),
        "description": np.frombuffer(text.encode(), np.uint8),
        "phi_i": adaptive.phi_i.astype(np.float32),
        "theta_i": adaptive.theta_i.astype(np.float32),
        "sigma": adaptive.sigma, "ndf": adaptive.ndf,
        "vndf": adaptive.vndf.reshape(*shape, *adaptive.vndf.shape[-2:]),
        "luminance": luminance.astype(np.float32).reshape(*shape, *image),
    }  # fmt: skip
    if spectral:
        fields["wavelengths"] = np.array([channel.wavelength_nm for channel in chosen], np.float32)
    fields["spectra" if spectral else "rgb"] = adaptive.data.reshape(*shape, -1, *image)
    fields["jacobian"] = np.array([1], np.uint8)
    fields["valid"] = np.packbits(above)
    if measured is not None:
        fields[MEASURED] = measured.reshape(*shape, *image).astype(np.uint8)
    return fields
