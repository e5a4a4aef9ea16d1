"""How far what a file says is from what was exported: the number in the notes of every table format."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fitter import directions
from fitter.export.subject import Subject
from fitter.formats.loading import load
from fitter.formats.registry import Loss

FloatArray = NDArray[np.float64]

#: Pairs that are compared, the incidences that a model draws them at, and the seed of both.
_PAIRS, _INCIDENCES, _SEED = 4000, 64, 1
#: No closer to the horizon than a receiver gets: beyond, tables end.
_STEEPEST = math.radians(80.0)
#: What is fainter than this, of the largest value, is not compared.
_FAINTEST = 1e-9
#: Above this share (p95) the file is called too coarse for what it holds.
TOO_COARSE = 0.1


def compared_pairs(subject: Subject, count: int = _PAIRS, seed: int = _SEED) -> tuple[FloatArray, FloatArray]:
    """Pairs (M, 3) to compare at. Of a model half are drawn from its own sampler, half evenly over the two
    hemispheres up to 80 deg; of a table they are its own samples."""
    if subject.table is not None:
        index = np.flatnonzero(subject.table.mask)
        index = index[np.unique(np.linspace(0, len(index) - 1, count).astype(np.intp))]
        wi, wo = subject.table.directions(index)
        above = wo[:, 2] > 0
        return wi[above], wo[above]
    assert subject.model is not None
    rng = np.random.default_rng(seed)
    wi, wo = _cap(rng, (count + 1) // 2), _cap(rng, (count + 1) // 2)
    drawn = [wi], [wo]
    each = math.ceil(count / 2 / _INCIDENCES)
    for k, incidence in enumerate(_cap(rng, _INCIDENCES)):
        found = subject.model.sample(incidence, each, seed=seed + k)
        some = found.wo[found.valid & (found.wo[:, 2] > math.cos(_STEEPEST))]
        drawn[0].append(np.broadcast_to(incidence, some.shape))
        drawn[1].append(some)
    return np.concatenate(drawn[0]), np.concatenate(drawn[1])


def even_pairs(subject: Subject, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Up to ``count`` pairs (M, 3), even over the hemispheres up to 80 deg, where the subject is known."""
    rng = np.random.default_rng(seed)
    wi, wo = _cap(rng, 4 * count), _cap(rng, 4 * count)
    known = np.flatnonzero(~subject.evaluate(wi, wo)[1])[:count]
    return wi[known], wo[known]


def fidelity(subject: Subject, path: Path, tool: str = "between its samples") -> Loss:
    """The file read back by this program against the subject, in a sentence."""
    back = load(path, negatives="keep")

    def there(wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        return back.evaluate(wi, wo)

    return of_function(subject, there, tool)


def of_function(
    subject: Subject,
    there: Callable[[FloatArray, FloatArray], tuple[FloatArray, NDArray[np.bool_]]],
    tool: str = "between its samples",
) -> Loss:
    """As :func:`fidelity`, of any function of the directions, which may have one channel for the first."""
    wi, wo = compared_pairs(subject)
    ours, outside = subject.evaluate(wi, wo)
    theirs, beyond = there(wi, wo)
    count = min(ours.shape[1], theirs.shape[1])
    ours, theirs = ours[:, :count], theirs[:, :count]
    known = ~outside & ~beyond & np.isfinite(theirs).all(axis=1) & seen(ours)
    if not known.any():
        return Loss("fidelity", "None of the directions compared is within what the file holds.")
    change = np.abs(theirs - ours)[known] / ours[known]
    half, most = np.quantile(change, [0.5, 0.95])
    where = (
        "at its own samples"
        if subject.table is not None
        else "half of them drawn from the model's own sampler, the rest evenly up to 80 deg"
    )
    said = (
        f"Read {tool} the file differs from its source by {half:.2%} in the median and by {most:.2%} at most "
        f"for 95 % of {int(known.sum())} directions, {where}"
    )
    if faint := int((~outside & ~seen(ours)).sum()):
        said += f"; {faint} more are below {_FAINTEST:g} of the largest value"
    if beyond.any():
        said += f"; {int(beyond.sum())} more lie outside what the file holds"
    if most > TOO_COARSE:
        return Loss("too-coarse", f"{said}. The target is too coarse for this lobe.")
    return Loss("fidelity", f"{said}.")


def seen(values: FloatArray) -> NDArray[np.bool_]:
    """Which of the values (M, C) are large enough, in all channels, for a relative difference to count."""
    return (values > _FAINTEST * values.max(axis=0, initial=0.0)).all(axis=1)


def _cap(rng: np.random.Generator, count: int) -> FloatArray:
    """Directions (count, 3), even in solid angle down to the steepest."""
    cosine = rng.uniform(math.cos(_STEEPEST), 1.0, count)
    phi = rng.uniform(-math.pi, math.pi, count)
    return directions.vector_from_spherical(np.arccos(cosine), phi)
