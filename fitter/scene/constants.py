"""What replaces a factor of a material that a plan leaves out: a constant per channel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.scene import coats, effects, fresnel
from fitter.scene.assembly import Scene
from fitter.scene.boxes import Angles
from fitter.scene.facets import as_facets
from fitter.scene.intervals import Interval, centre
from fitter.scene.materials import Material, ModelMaterial
from fitter.scene.search import hull
from fitter.scene.surfaces import Surfaces

FloatArray = NDArray[np.float64]


def constants_of(
    scene: Scene, m: int, one: Material, surfaces: Surfaces | None = None
) -> dict[str, Any]:  # fmt: skip
    """Of ``one`` in place of material m, of each channel the value whose largest relative error is least."""
    if not isinstance(one, ModelMaterial):
        return {}
    model = one.model
    wanted = {"fresnel", "passage"}.intersection(effects.effects(model))
    if not wanted:
        return {}
    surfaces = surfaces or Surfaces(scene)
    start = surfaces.start(m, tuple(range(len(scene.lamps))))

    def over(of: Callable[[Angles], tuple[FloatArray, FloatArray]]) -> tuple[float, float]:
        low, high = (min(max(end, 0.0), 1.0) for end in hull(surfaces, start, of))
        return min(low, high), max(low, high)

    def passed(channel: int) -> tuple[float, float]:
        def middle(angles: Angles) -> tuple[FloatArray, FloatArray]:
            found = coats.passage(model.spec, effects.of_channel(model, channel), angles).mid
            return found, found

        return over(middle)

    def reflected(channel: int) -> tuple[float, float]:
        spec, values = as_facets(model.spec, effects.of_channel(model, channel))
        f = fresnel.reflectance(spec, values, cosines).mid
        return float(f.min()), float(f.max())

    def cosine(angles: Angles) -> tuple[FloatArray, FloatArray]:
        c = fresnel.facet_cosine(angles)
        return c.lo, c.hi

    if "fresnel" in wanted:
        cosines = Interval.of(np.linspace(*over(cosine), 65))
    ranges = {"fresnel": reflected, "passage": passed}
    found = {e: [centre(*ranges[e](k)) for k in range(len(model.channels))] for e in wanted}
    # As the kernels hold it.
    return {effect: np.asarray(x, np.float32).astype(np.float64) for effect, x in found.items()}
