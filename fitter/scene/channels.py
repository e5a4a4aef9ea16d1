"""Channels that need not be told apart: one is computed, and the others are it times a number.

A path from a lamp over n surfaces to the camera carries level f_1 ... f_n. Of two channels the ratio of each
factor is enclosed: of lamps' levels and an environment's pixels as they are; of a separable model whose
nonlinear parameters are shared sum_j a_j t_j / sum_j b_j t_j, which lies between the least and the largest
a_j/b_j since no term t_j is negative; of anything else it is 1 where all parameters are equal, and unknown
where not. Radiance is a sum of paths, so that its ratio lies in the hull [p, q] of the products over all n.
Scaled by 2 p q/(p + q) a channel is at most (q - p)/(q + p) off, everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.models import ReflectanceModel
from fitter.models.base import SeparableModel
from fitter.scene import wording
from fitter.scene.assembly import Scene, chosen
from fitter.scene.intervals import centre
from fitter.scene.lights import Lamp
from fitter.scene.materials import Material, ModelMaterial, TableMaterial
from fitter.scene.search import Decision

FloatArray = NDArray[np.float64]
#: Least and largest ratio of two channels; None where it is not known.
Ratio = tuple[float, float] | None

_SAME: tuple[float, float] = (1.0, 1.0)
#: Ratios that lie further apart are of no use, and pixels that tell so.
_APART, _PIXELS = 0.95, 1_000


@dataclass(frozen=True)
class Merged:
    """Channel c of a picture is ``scale[c]`` times channel ``of[c]`` of those that are computed, which are
    the scene's ``columns``."""

    columns: tuple[int, ...]
    of: tuple[int, ...]
    scale: tuple[float, ...]

    def apart(self, radiance: NDArray[Any]) -> NDArray[Any]:
        """All channels (N, C) of those computed."""
        return radiance[:, list(self.of)] * np.asarray(self.scale, radiance.dtype)

    def lamp(self, one: Lamp) -> Lamp:
        """A lamp of the channels that are computed."""
        columns = list(self.columns)
        picture = None if one.picture is None else one.picture[..., columns]
        return replace(one, level=one.level[columns], picture=picture)

    def material(self, one: Material) -> Material:
        """A material of the channels that are computed; one with a single channel is as it was."""
        if not isinstance(one, ModelMaterial) or len(one.model.channels) == 1:
            return one
        columns = np.array(self.columns)
        constants = {name: np.asarray(value)[columns] for name, value in one.constants.items()}
        return replace(one, model=chosen(one.model, columns), constants=constants)


def merged(scene: Scene, bounces: int, tolerance: float) -> tuple[Merged | None, float]:
    """As few channels as stay within ``tolerance`` of all, and the error's bound; None where all are kept."""

    def scaled(c: int, reference: int) -> tuple[float, float]:
        found = _ratio(scene, c, reference, bounces)
        return (1.0, np.inf) if found is None else _scaled(*found)

    groups: list[list[tuple[float, int]]] = []
    for c in range(len(scene.spec.channels)):
        for group in groups:
            factor, error = scaled(c, group[0][1])
            if error <= tolerance:
                group.append((factor, c))
                break
        else:
            groups.append([(1.0, c)])
    columns: list[int] = []
    placed: dict[int, tuple[int, float]] = {}
    worst = 0.0
    for group in groups:
        # The brightest: scaled down, what it is off over 0.01 F by other steps of a plan stays as small.
        brightest = max(group)[1]
        placed[brightest] = len(columns), 1.0
        columns.append(brightest)
        for _, c in group:
            if c == brightest:
                continue
            factor, error = scaled(c, brightest)
            if error <= tolerance and factor <= 1.0:
                placed[c] = placed[brightest][0], factor
                worst = max(worst, error)
            else:
                placed[c] = len(columns), 1.0
                columns.append(c)
    if len(columns) == len(placed):
        return None, 0.0
    of, scale = zip(*(placed[c] for c in range(len(placed))), strict=True)
    return Merged(tuple(columns), of, scale), worst


def decision(scene: Scene, found: Merged | None, bound: float) -> dict[str, Any]:
    """The plan's entry."""
    names = scene.spec.channels
    if found is None:
        sentence = f"{', '.join(names)} kept apart: lights or materials tell them apart"
        return wording.kept("all", "channels", sentence)
    groups = [[names[c] for c, k in enumerate(found.of) if k == j] for j in range(len(found.columns))]
    told = "; ".join(" = ".join(group) for group in groups)
    error = f"error <= {100 * bound:.2g} %" if bound else "error 0"
    sentence = (
        f"{len(found.columns)} of {len(names)} channels computed, the others are these but for a factor "
        f"({told}): {error}"
    )
    proved = wording.decision("channels", "all", Decision("bounded", bound, 0.0, 0), True, sentence)
    return {**proved, "computed": [names[c] for c in found.columns]}


def _scaled(low: float, high: float) -> tuple[float, float]:
    """The factor for ratios in [low, high], and the largest relative error."""
    if high == 0:
        return 0.0, 0.0
    if not np.isfinite(high):
        return 1.0, np.inf
    # 4 roundings of the ends and of the factor itself; equal ends are exact but for those.
    return centre(low, high), (high - low) / (high + low) + (0.0 if low == high else 1e-15)


def _ratio(scene: Scene, c: int, reference: int, bounces: int) -> Ratio:
    """Of the radiance of channel c to that of another."""
    # A few pixels of an environment mostly show that channels differ by more than is of use.
    some = [_lamp(one, c, reference, thin=True) for one in scene.lamps]
    if any(found and found[0] < (1.0 - _APART) * found[1] for found in some):
        return None
    lamps = [_lamp(one, c, reference) for one in scene.lamps]
    least, most = np.inf, 0.0
    for one in scene.materials:
        found = _material(one, c, reference)
        if found is None:
            return None
        least, most = min(least, found[0]), max(most, found[1])
    seen = [found for found, one in zip(lamps, scene.lamps, strict=True) if found and not one.is_delta]
    lit = [found for found in lamps if found]
    low, high = np.inf, 0.0
    for n in range(bounces + 2):
        for found in lit if n else seen:
            low = min(low, found[0] * least**n)
            high = max(high, found[1] * most**n)
    return (low, high) if low <= high else _SAME


def _lamp(one: Lamp, c: int, reference: int, *, thin: bool = False) -> Ratio:
    """None where the lamp is dark in both channels."""
    if one.picture is None:
        return _hull(one.level[c : c + 1], one.level[reference : reference + 1])
    pixels = one.picture.reshape(-1, one.picture.shape[2])
    pixels = pixels[:: max(1, len(pixels) // _PIXELS)] if thin else pixels
    return _hull(pixels[:, c] * one.level[c], pixels[:, reference] * one.level[reference])


def _material(one: Material, c: int, reference: int) -> Ratio:
    if isinstance(one, TableMaterial):
        return _SAME if one.single else None
    assert isinstance(one, ModelMaterial)
    model = one.model
    if len(model.channels) == 1 or not (differ := _differing(model, c, reference)):
        return _SAME
    if not isinstance(model, SeparableModel) or differ & set(model.nonlinear):
        return None
    rows = model.coefficients(model.spec, model.linear, model.nonlinear)
    every = np.array([np.broadcast_to(np.asarray(row), (len(model.channels),)) for row in rows], float)
    # One that is black in both channels is so whatever the factor.
    return _hull(every[:, c], every[:, reference]) or _SAME


def _differing(model: ReflectanceModel, c: int, reference: int) -> set[str]:
    per_channel = {name: np.asarray(value) for name, value in model.values.items() if np.size(value) > 1}
    return {name for name, value in per_channel.items() if value[c] != value[reference]}


def _hull(over: Sequence[float] | FloatArray, under: Sequence[float] | FloatArray) -> Ratio:
    """The least and largest quotient of those that are not 0/0."""
    a, b = np.asarray(over), np.asarray(under)
    some = (a != 0) | (b != 0)
    if not some.any():
        return None
    with np.errstate(divide="ignore"):
        found = a[some] / b[some]
    return float(found.min()), float(found.max())
