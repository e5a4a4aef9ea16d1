"""Progressive rendering: passes of one sample a pixel, mean and standard error, and when to stop."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.fitting.compiling import metering
from fitter.progress import Progress, ignore
from fitter.scene.assembly import Scene
from fitter.scene.integrate import Integrator
from fitter.scene.materials import TableMaterial
from fitter.scene.regions import Region, Tiles
from fitter.scene.settings import Settings

if TYPE_CHECKING:
    from fitter.scene.planning import Plan

FloatArray = NDArray[np.float64]
Precision = Literal["float32", "float64"]

#: Rays of a batch: the one size that programs are compiled for.
BATCH = 1 << 14
#: Before so many samples a standard error says little.
_FEWEST = 8


@dataclass
class Picture:
    """A rendered scene. radiance, standard_error (H, W, C), W/(m2 sr); hit (H, W): share of the samples that
    met a shape; history: (samples, seconds, error) as it went; stopped: by what."""

    radiance: FloatArray
    standard_error: FloatArray
    hit: FloatArray
    channels: tuple[str, ...]
    samples: int
    seconds: float
    seed: int
    precision: Precision
    stopped: str
    history: list[tuple[int, float, float]]
    compile_seconds: float = 0.0
    notes: list[str] = field(default_factory=list[str])
    tables: dict[str, Any] = field(default_factory=dict[str, Any])
    plan: dict[str, Any] | None = None
    layers: dict[str, FloatArray] = field(default_factory=dict[str, FloatArray])

    @property
    def reference(self) -> float:
        """The mean over pixels that show a shape, of the radiance clipped at its 99th percentile."""
        return reference(self.radiance, self.hit)

    @property
    def error(self) -> float:
        """Root mean square of the standard errors over the reference."""
        return _error(self.standard_error, self.radiance, self.hit)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, without the pixels."""
        height, width, _ = self.radiance.shape
        return {
            "kind": "brdf-fitter/picture", "width": width, "height": height, "channels": list(self.channels),
            "samples": self.samples, "seconds": self.seconds,
            "compile_seconds": self.compile_seconds, "seed": self.seed, "precision": self.precision,
            "stopped": self.stopped, "error": self.error, "reference": self.reference,
            "mean": self.radiance.mean(axis=(0, 1)).tolist(),
            "history": [
                {"samples": s, "seconds": t, "error": e} for s, t, e in self.history
            ],
            "notes": self.notes, "tables": self.tables, "plan": self.plan, "layers": list(self.layers),
        }  # fmt: skip


def reference(radiance: FloatArray, hit: FloatArray) -> float:
    """F: see :attr:`Picture.reference`; of all pixels where none shows a shape."""
    mean = radiance.mean(axis=2)
    shown = mean[hit > 0] if (hit > 0).any() else mean.reshape(-1)
    return float(np.minimum(shown, np.percentile(shown, 99)).mean())


def _error(standard_error: FloatArray, radiance: FloatArray, hit: FloatArray) -> float:
    scale = reference(radiance, hit)
    return float(np.sqrt((standard_error**2).mean())) / scale if scale > 0 else 0.0


def render(
    scene: Scene,
    *,
    samples: int | None = None,
    seconds: float | None = None,
    target_error: float | None = None,
    seed: int = 0,
    precision: Precision | Literal["auto"] = "float32",
    by: Plan | None = None,
    settings: Settings | None = None,
    progress: Progress = ignore,
) -> Picture:
    """Render until ``samples`` of each pixel, ``seconds``, or ``target_error`` (see :attr:`Picture.error`),
    whichever comes first; 16 samples where none is given. The same seed and number of samples give the same
    picture. ``by`` a plan, which is kept with the picture; ``settings`` are its or made by hand; precision
    "auto" is what the plan chose. Raises SpecError: a limit that makes no sense, "auto" without a plan;
    Cancelled.
    """
    if precision == "auto":
        precision = _planned(by)
    limits = {"samples": samples, "seconds": seconds, "target_error": target_error}
    for name, limit in limits.items():
        if limit is not None and not 0 < limit < float("inf"):
            raise SpecError(
                f"{name} is {limit}", code="bad-limit", parameter=name, remedy="give a positive number"
            )
    if all(limit is None for limit in limits.values()):
        samples = 16
    whole = Region.whole(Tiles.of(scene.spec.camera, 1, 1))
    chosen = [(settings or Settings.everything(scene), whole)]
    if settings is None and by is not None:
        chosen = [(one.settings, one.region) for one in by.programs]
    integrators = [(Integrator(scene, some, np.dtype(precision)), region.pixels) for some, region in chosen]
    began = time.perf_counter()
    with metering() as meter:
        picture = _rendered(scene, integrators, samples, seconds, target_error, seed, progress)
    picture.compile_seconds = meter.between(began, time.perf_counter())
    picture.plan = None if by is None else dict(by.document)
    return picture


def _rendered(
    scene: Scene, integrators: Sequence[tuple[Integrator, NDArray[np.intp]]], samples: int | None,
    seconds: float | None, target_error: float | None, seed: int, progress: Progress,
) -> Picture:  # fmt: skip
    """The picture of integrators, each of its own pixels."""
    began = time.perf_counter()
    camera, count = scene.spec.camera, len(scene.spec.channels)
    total = camera.width * camera.height
    mean, spread, hits = np.zeros((total, count)), np.zeros((total, count)), np.zeros(total)
    done, stopped, error = 0, "", float("inf")
    history: list[tuple[int, float, float]] = []
    shape = camera.height, camera.width
    while not stopped:
        for k, (integrator, pixels) in enumerate(integrators):
            size = min(BATCH, padded(len(pixels)))
            for start in range(0, len(pixels), size):
                rows = pixels[start : start + size]
                # What fills a batch up repeats its last pixel, and is thrown away.
                filled = np.pad(rows, (0, size - len(rows)), mode="edge")
                found, met = integrator.batch(filled, (seed, done, start + k * total))
                one = found[: len(rows)].astype(np.float64)
                away = one - mean[rows]
                mean[rows] += away / (done + 1)
                spread[rows] += away * (one - mean[rows])
                hits[rows] += met[: len(rows)]
                progress(_share(done + start / total, began, samples, seconds), f"sample {done + 1}")
        done += 1
        spent = time.perf_counter() - began
        if done > 1:
            u = np.sqrt(spread / (done * (done - 1)))
            error = _error(
                u.reshape(*shape, count), mean.reshape(*shape, count), (hits / done).reshape(shape)
            )
        if done & (done - 1) == 0 and done > 1:
            history.append((done, spent, error))
        if samples is not None and done >= samples:
            stopped = "samples"
        elif seconds is not None and spent >= seconds and done > 1:
            stopped = "seconds"
        elif target_error is not None and done >= _FEWEST and error <= target_error:
            stopped = "target_error"
    spent = time.perf_counter() - began
    u = np.sqrt(spread / (done * max(done - 1, 1)))
    if done > 1 and history[-1][0] != done:
        history.append((done, spent, error))
    tables = {
        name: one.extrapolation.to_dict()
        for name, one in zip(scene.names, scene.materials, strict=True)
        if isinstance(one, TableMaterial)
    }
    return Picture(
        mean.reshape(*shape, count), u.reshape(*shape, count), (hits / done).reshape(shape),
        scene.spec.channels, done, spent, seed, _name(integrators[0][0].dtype), stopped, history,
        notes=_notes(scene), tables=tables,
    )  # fmt: skip


def _name(dtype: np.dtype[np.floating]) -> Precision:
    return "float32" if dtype == np.float32 else "float64"


def _planned(by: Plan | None) -> Precision:
    if by is None:
        raise SpecError(
            "a plan chooses the precision, and there is none", code="no-plan", parameter="precision",
            remedy="plan first (`scene render --plan`), or give float32 or float64",
        )  # fmt: skip
    return by.document["precision"]


def padded(total: int) -> int:
    """Rays of a batch of a small picture: a power of two."""
    return max(256, 1 << (total - 1).bit_length())


def _share(done: float, began: float, samples: int | None, seconds: float | None) -> float:
    shares = [0.0]
    if samples is not None:
        shares.append(done / samples)
    if seconds is not None:
        shares.append((time.perf_counter() - began) / seconds)
    return min(max(shares), 1.0)


def _notes(scene: Scene) -> list[str]:
    """What the tables could not answer."""
    found: list[str] = []
    for name, one in zip(scene.names, scene.materials, strict=True):
        if not isinstance(one, TableMaterial):
            continue
        if one.note:
            found.append(f"{name}: {one.note}")
        told = one.extrapolation
        if told.outside and told.theta_l_deg and told.theta_v_deg:
            share = told.outside / told.asked
            found.append(
                f"{name}: {share:.2%} of the directions that the scene needs lie outside what was measured "
                f"(light at {told.theta_l_deg[0]:.0f} to {told.theta_l_deg[1]:.0f} degrees from the normal, "
                f"viewer at {told.theta_v_deg[0]:.0f} to {told.theta_v_deg[1]:.0f}): extrapolated"
            )
        if told.clamped:
            found.append(f"{name}: {told.clamped / told.asked:.2%} of the values are negative: taken as 0")
    return found
