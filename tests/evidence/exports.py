"""Exports read by Mitsuba 3: is the ``measured`` BSDF of an exported file ours times cos(theta_o)?

Fits of the bundled tables, models of every family, and tables themselves, as ``rgl``. At 10^4 directions,
half of them drawn from the material's own sampler (of a table by rejection, exactly), the rest even over both
hemispheres up to 80 deg or as far as was measured; not those that the resolution was chosen by.
"""

from __future__ import annotations

import importlib
import re
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fitter
from fitter.export import Subject, subject, write
from fitter.export.fidelity import compared_pairs, even_pairs, seen
from fitter.sampling import TableSampler
from tests.evidence.study import Outcome, Study

FloatArray = NDArray[np.float64]

POINTS = 10_000
TABLES = Path(__file__).resolve().parents[2] / "data" / "tables"
#: On the 95 % quantile of the relative difference.
BOUND = 0.01
#: What an export states: of a table what is expected, of a model what was found.
_STATED = (r"within ([\d.]+)% of the table", r"by ([\d.]+)% at most")
_INCIDENCES = 64
_SHOWN = ("difference p50", "difference p95", "as stated", "pairs", "file, MB")

_FITS = {
    "glossy_paint": ("ward", "ward:bounded", "torrance_sparrow", "torrance_sparrow:ggx:smith", "lafortune",
                     "lafortune:2", "oren_nayar"),
    "diffuse_plaster": ("lambert", "oren_nayar", "oren_nayar:full", "ward", "torrance_sparrow"),
    "brushed_metal": ("ward:anisotropic", "ward:bounded:anisotropic",
                      "torrance_sparrow:ggx:smith:anisotropic"),
}  # fmt: skip
_MODELS: Mapping[str, Mapping[str, Any]] = {
    "ward:duer": {"alpha": 0.1}, "torrance_sparrow:smith": {"alpha": 0.05, "f0": 0.5},
    "lafortune:3": {"n_1": 10.0, "n_2": 60.0, "n_3": 30.0, "gamma_2": -0.7, "gamma_3": 0.3},
    "oren_nayar:eon": {"rho": 0.8, "sigma": 0.7},
}  # fmt: skip


def _subjects() -> dict[str, Callable[[], Any]]:
    found: dict[str, Callable[[], Any]] = {}
    for table, names in _FITS.items():
        for name in names:
            found[f"{name} of {table}"] = lambda table=table, name=name: fitter.fit(
                fitter.load(TABLES / f"{table}.csv"), name
            )
    for name, values in _MODELS.items():
        found[name] = lambda name=name, values=values: fitter.models.create(name, **values)
    for table in ("glossy_paint", "diffuse_plaster"):
        found[f"{table} itself"] = lambda table=table: fitter.load(TABLES / f"{table}.csv")
    return found


def judge(name: str, share: float, seed: int) -> Outcome:
    mi: Any = importlib.import_module("mitsuba")
    mi.set_variant("scalar_rgb")
    what = subject(_subjects()[name]())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.bsdf"
        told = write(what, "rgl", path, unconverged=True)
        size = path.stat().st_size / 1e6
        bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    wi, wo = _pairs(what, max(1000, round(POINTS * share)), seed)
    context, at = mi.BSDFContext(), mi.SurfaceInteraction3f()
    theirs = np.empty((len(wi), 3))
    for k, (i, o) in enumerate(zip(wi.tolist(), wo.tolist(), strict=True)):
        at.wi = i
        theirs[k] = np.asarray(bsdf.eval(context, at, o))
    ours, outside = what.evaluate(wi, wo)
    kept = ~outside & seen(ours)
    change = np.abs(theirs[:, : ours.shape[1]] / wo[:, 2:] - ours)[kept] / ours[kept]
    half, most = (float(q) for q in np.quantile(change, [0.5, 0.95]))
    notes = " ".join(note.message for note in told.notes)
    stated = float(re.findall(_STATED[what.table is None], notes)[-1]) / 100
    # Of fewer directions more may be off by chance: four standard deviations of it.
    allowed = 0.05 + (0.0 if share >= 1 else 4 * (0.05 / len(change)) ** 0.5)
    broken = (
        []
        if (change > BOUND).mean() <= allowed
        else [{"what": "differs too much", "p95": most, "bound": BOUND}]
    )
    return Outcome(dict(zip(_SHOWN, (half, most, stated, int(kept.sum()), size), strict=True)), broken)


def _pairs(what: Subject, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    if what.table is None:
        return compared_pairs(what, count, seed)
    wi, wo = even_pairs(what, count // 2, seed)
    sampler = TableSampler(what.table)
    each = -(-count // (2 * _INCIDENCES))
    for k, incidence in enumerate(wi[:_INCIDENCES].copy()):
        found = sampler.sample(incidence, each, seed=seed + k)
        some = found.wo[found.valid & (found.wo[:, 2] > np.cos(np.deg2rad(80.0)))]
        wi = np.concatenate([wi, np.broadcast_to(incidence, some.shape)])
        wo = np.concatenate([wo, some])
    return wi, wo


STUDY = Study(
    "exports", "Exports, read by Mitsuba 3",
    "The measured BSDF of an exported RGL file is ours times cos(theta_o), within 1 % for 95 % of the "
    "directions, half of them drawn from the material's own sampler",
    _SHOWN, lambda: list(_subjects()), judge, subject="material", least=3,
)  # fmt: skip
