"""Mitsuba 3 plugins, registered when this module is imported, for the variant that is set then.

    import mitsuba as mi
    mi.set_variant("scalar_rgb")
    import fitter.export.mitsuba
    bsdf = mi.load_dict({"type": "brdf_fitter_model", "filename": "fits/ward.json"})

``brdf_fitter_model`` is a model of this library, from the file of a fit or a model's document; drawn,
evaluated and its density stated by the model itself. ``brdf_fitter_table`` is the interpolant of a measured
table, of any format (option ``quantity`` where the file can't say), drawn from exactly, by rejection. Both
take one channel or three, read as linear RGB. A table's sampler takes some milliseconds to get to know an
incidence: it is for comparisons, and a table exported as ``rgl`` for pictures.

Mitsuba traces from the eye: its wi is the viewer here, and its wo the light. f_r of all models and tables is
evaluated so; the models are reciprocal, of tables the order matters and is kept.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

import fitter
from fitter.documents import read_document
from fitter.errors import SpecError
from fitter.models import ReflectanceModel, from_dict
from fitter.models.lobes import mixture_pdf, sample_mixture
from fitter.models.pair import Pair
from fitter.sampling import TableSampler

#: Its classes depend on the variant: nothing that a type checker could know.
mi: Any = importlib.import_module("mitsuba")

FloatArray = NDArray[np.float64]
MODEL, TABLE = "brdf_fitter_model", "brdf_fitter_table"


class _Drawn(mi.BSDF):
    """A BSDF of numbers from this library: scalar variants, one direction at a time."""

    channels: int

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        if not str(mi.variant()).startswith("scalar"):
            raise SpecError(
                f"the variant {mi.variant()} evaluates many directions at once", code="mitsuba-variant",
                remedy='set a scalar variant, or export the material as rgl and use "measured"',
            )  # fmt: skip
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
        self.m_components = [flags]
        self.m_flags = flags

    def sample(self, ctx: Any, si: Any, sample1: float, sample2: Any, active: bool = True) -> Any:
        found = mi.BSDFSample3f()
        if not (ctx.is_enabled(mi.BSDFFlags.GlossyReflection) and si.wi[2] > 0):
            return found, mi.Spectrum(0.0)
        wo, pdf, value = self.drawn(
            np.array(si.wi, np.float64), float(sample1), np.array(sample2, np.float64)
        )
        if not (pdf > 0 and wo[2] > 0):
            return found, mi.Spectrum(0.0)
        found.wo, found.pdf, found.eta = wo.tolist(), pdf, 1.0
        found.sampled_type, found.sampled_component = +mi.BSDFFlags.GlossyReflection, 0
        return found, _spectrum(value * (wo[2] / pdf))

    def eval(self, ctx: Any, si: Any, wo: Any, active: bool = True) -> Any:
        if not (ctx.is_enabled(mi.BSDFFlags.GlossyReflection) and si.wi[2] > 0 and wo[2] > 0):
            return mi.Spectrum(0.0)
        value = self.value(np.array(si.wi, np.float64), np.array(wo, np.float64))
        return _spectrum(value * float(wo[2]))

    def pdf(self, ctx: Any, si: Any, wo: Any, active: bool = True) -> float:
        if not (ctx.is_enabled(mi.BSDFFlags.GlossyReflection) and si.wi[2] > 0 and wo[2] > 0):
            return 0.0
        return self.density(np.array(si.wi, np.float64), np.array(wo, np.float64))

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: bool = True) -> Any:
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def to_string(self) -> str:
        return f"{type(self).__name__}[]"

    # What a kind of material says, of unit vectors (3,) above the horizon; ``viewer`` is Mitsuba's wi.

    def value(self, viewer: FloatArray, light: FloatArray) -> FloatArray:
        raise NotImplementedError

    def density(self, viewer: FloatArray, light: FloatArray) -> float:
        raise NotImplementedError

    def drawn(self, viewer: FloatArray, u: float, v: FloatArray) -> tuple[FloatArray, float, FloatArray]:
        """A direction to the light, its density and f_r."""
        raise NotImplementedError


class Model(_Drawn):
    """A reflectance model."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self._evaluate, self._pdf, self._draw = _compiled(_model(_file(props)))

    def value(self, viewer: FloatArray, light: FloatArray) -> FloatArray:
        return np.asarray(self._evaluate(light, viewer))

    def density(self, viewer: FloatArray, light: FloatArray) -> float:
        return float(self._pdf(viewer, light))

    def drawn(self, viewer: FloatArray, u: float, v: FloatArray) -> tuple[FloatArray, float, FloatArray]:
        wo, pdf, value = self._draw(viewer, _bits(u, v))
        return np.asarray(wo), float(pdf), np.asarray(value)


class Table(_Drawn):
    """A measured table: its interpolant, 0 where nothing was measured."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        options: dict[str, Any] = {"quantity": str(props["quantity"])} if "quantity" in props else {}
        self._table = fitter.load(_file(props), **options)
        _countable(len(self._table.channels))
        self._sampler = TableSampler(self._table)

    def value(self, viewer: FloatArray, light: FloatArray) -> FloatArray:
        found, outside = self._table.evaluate(light[None], viewer[None])
        return np.maximum(found[0], 0.0) * (not outside[0])

    def density(self, viewer: FloatArray, light: FloatArray) -> float:
        return float(self._sampler.pdf(viewer, light, allow_extrapolated=True)[0])

    def drawn(self, viewer: FloatArray, u: float, v: FloatArray) -> tuple[FloatArray, float, FloatArray]:
        first, second = _bits(u, v).tolist()
        found = self._sampler.sample(viewer, 1, first << 32 | second, allow_extrapolated=True)
        wo = found.wo[0]
        return wo, float(found.pdf[0]), self.value(viewer, wo)


def _compiled(model: ReflectanceModel) -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]:
    """f_r(wi, wo), pdf(wi, wo) and a draw (wi, two words of randomness) -> (wo, pdf, f_r), each one program
    that holds the model's numbers."""

    def evaluate(wi: jax.Array, wo: jax.Array) -> jax.Array:
        return model.value(Pair.split(wi, wo))

    def pdf(wi: jax.Array, wo: jax.Array) -> jax.Array:
        p = Pair.split(wi, wo)
        lobes, shares, _ = model.mixture(p.ix, p.iy, p.iz)
        return mixture_pdf(lobes, shares, p, False)

    def draw(wi: jax.Array, words: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        lobes, shares, deltas = model.mixture(wi[0], wi[1], wi[2])
        key = jax.random.wrap_key_data(words, impl="threefry2x32")
        wo = sample_mixture(lobes, shares, deltas, wi, 1, key)[0][0]
        return wo, pdf(wi, wo), evaluate(wi, wo)

    return jax.jit(evaluate), jax.jit(pdf), jax.jit(draw)


def _bits(u: float, v: FloatArray) -> NDArray[np.uint32]:
    """Two words (2,) of the renderer's three random numbers, by which the library's own are keyed."""
    first = int(u * 2**32) ^ (int(v[1] * 2**24) << 4)
    return np.array([first % 2**32, int(v[0] * 2**32) % 2**32], np.uint32)


def _model(path: Path) -> ReflectanceModel:
    document = read_document(path, "not-a-model")
    if document.get("kind") == "brdf-fitter/fits":
        raise SpecError(
            "the file holds several fits", code="which-fit", file=str(path),
            remedy="write the one with `brdf-fitter export --model NAME --to json`",
        )  # fmt: skip
    model = from_dict(document.get("model", document))
    fitter.export.subject(model)  # refuses what is no BRDF
    _countable(len(model.channels))
    return model


def _file(props: Any) -> Path:
    name = str(props["filename"])
    return Path(str(mi.file_resolver().resolve(name)))


def _countable(channels: int) -> None:
    if channels not in (1, 3):
        raise SpecError(
            f"a Mitsuba BSDF here has one channel or three, and this has {channels}", code="export-channels",
            parameter="channels", remedy="export three of them as json or rgl",
        )  # fmt: skip


def _spectrum(value: FloatArray) -> Any:
    return mi.Spectrum(float(value[0])) if len(value) == 1 else mi.Spectrum(*value.tolist())


mi.register_bsdf(MODEL, Model)
mi.register_bsdf(TABLE, Table)
