"""Settings: what a plan leaves of a scene, which pictures are rendered with."""

from __future__ import annotations

from dataclasses import dataclass, replace

from fitter.scene.assembly import Scene
from fitter.scene.channels import Merged
from fitter.scene.materials import Material


@dataclass(frozen=True)
class Settings:
    """What a plan leaves of a scene.

    samples, points, first, shadows : of each lamp how many samples (with extent), how many points each way
    stand for it where it lights what the camera sees (0: it is sampled), whether it does light that
    (reflections are lit by all), whether shapes may hide it. direct : the materials for light that comes
    straight from a lamp to what the camera sees; materials : those for all else. channels : which are
    computed, None for all; materials have those. blank : that no shape is seen, which needs none of them.
    """

    bounces: int
    samples: tuple[int, ...]
    points: tuple[int, ...]
    first: tuple[bool, ...]
    shadows: tuple[bool, ...]
    direct: tuple[Material, ...]
    materials: tuple[Material, ...]
    channels: Merged | None = None
    blank: bool = False

    @staticmethod
    def everything(scene: Scene) -> Settings:
        count = len(scene.lamps)
        return Settings(
            bounces=scene.spec.bounces, samples=(scene.spec.light_samples,) * count, points=(0,) * count,
            first=(True,) * count, shadows=(True,) * count, direct=scene.materials, materials=scene.materials,
        )  # fmt: skip

    def merge(self, channels: Merged) -> Settings:
        """These, of the channels that are computed."""
        direct, materials = (tuple(map(channels.material, some)) for some in (self.direct, self.materials))
        return replace(self, channels=channels, direct=direct, materials=materials)

    def lit(self, depth: int) -> list[int]:
        """The lamps that light surfaces at this depth."""
        return [k for k, on in enumerate(self.first) if on or depth > 0]

    def points_at(self, k: int, depth: int) -> int:
        """The points each way that stand for lamp k at this depth, 0 where it is sampled."""
        return self.points[k] if depth == 0 else 0
