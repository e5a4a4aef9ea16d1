"""Subject: what is exported, a model or a table, behind one face."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitter._version import __version__
from fitter.errors import SpecError
from fitter.formats.output import one_line
from fitter.metadata import Channel, Symmetry
from fitter.table import Table

if TYPE_CHECKING:
    from fitter.compression import CompressedTable
    from fitter.fitting import FitResult
    from fitter.models import ReflectanceModel

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Directions that are evaluated together: what the largest takes stays below some 100 MB.
_SIZES = (64, 4096, 65536)


@dataclass(frozen=True)
class Subject:
    """A model, with the fit it comes from where there is one, or a table: one of ``model`` and ``table``.

    channels : names, and wavelengths where they are known. remark : a sentence for the head of files.
    """

    name: str
    channels: tuple[Channel, ...]
    symmetry: Symmetry
    model: ReflectanceModel | None = None
    fit: FitResult | None = None
    table: Table | None = None
    remark: str = ""

    def evaluate(self, wi: FloatArray, wo: FloatArray) -> tuple[FloatArray, BoolArray]:
        """f_r (M, C) in 1/sr without the cosine, of unit vectors (M, 3), and (M,) where not measured."""
        if self.table is not None:
            return self.table.evaluate(wi, wo)
        assert self.model is not None
        # Each size is a compiled program of its own: few of them.
        size = next((size for size in _SIZES if len(wi) <= size), _SIZES[-1])
        parts: list[FloatArray] = []
        for start in range(0, len(wi), size):
            pair = [w[start : start + size] for w in (wi, wo)]
            count = len(pair[0])
            pair = [np.pad(w, ((0, size - count), (0, 0)), mode="edge") for w in pair]
            parts.append(np.asarray(self.model.evaluate(*pair), np.float64)[:count])
        return np.concatenate(parts), np.zeros(len(wi), bool)

    def comments(self) -> list[str]:
        """Lines for the head of a file: what this is, where it comes from, how good it is."""
        lines = [f"Written by brdf-fitter {__version__}.", *([plain(self.remark)] if self.remark else [])]
        if self.table is not None:
            return [*lines, f"Measured table {plain(self.name)}, sha256 {self.table.hash[:16]}."]
        assert self.model is not None
        lines.append(f"Model {self.model.spec.name}, channels {plain(', '.join(self.model.channels))}.")
        if self.fit is not None:
            table, metrics = self.fit.table, self.fit.metrics
            lines += [
                f"Fitted to {plain(str(table.get('name', '')))}, sha256 {str(table.get('hash'))[:16]}: "
                f"{self.fit.status.replace('_', ' ')}, rms residual {metrics['rmse']:.3g} 1/sr, "
                f"{metrics['relative_rmse']:.1%} of the value.",
                *(f"Warning: {plain(warning)}" for warning in self.fit.warnings),
            ]
        return lines

    def parameter_lines(self) -> list[str]:
        """Lines "name = value (u = ...) unit: description", one per parameter and channel."""
        assert self.model is not None
        found: list[str] = []
        for p in self.model.table:
            values = np.asarray(self.model.values[p.name])
            u = np.full(values.shape, np.nan)
            if self.fit is not None and p.name in self.fit.parameters:
                u = np.broadcast_to(self.fit.parameters[p.name].standard_uncertainty, values.shape)
            for k in range(values.size):
                label = f"{p.name}[{plain(self.model.channels[k])}]" if values.ndim else p.name
                spread = float(u.reshape(-1)[k])
                stated = f" (u = {spread:.2g}, k = 1)" if np.isfinite(spread) else ""
                unit = "" if p.unit == "1" else f" {p.unit}"
                found.append(f"{label} = {float(values.reshape(-1)[k]):.6g}{unit}{stated}: {p.description}")
        return found


def plain(text: str) -> str:
    """One line of printable ASCII that ends no comment of any language: names are strangers' words."""
    kept = "".join(c if " " <= c <= "~" else "?" for c in one_line(text))
    kept = re.sub(r"-(?=-)", "- ", kept).replace("*/", "* /")
    return kept.translate(str.maketrans("\\<>", "/()"))


def subject(
    source: FitResult | ReflectanceModel | Table | CompressedTable | Subject, *, name: str | None = None,
    channels: Sequence[Channel] | None = None,
) -> Subject:  # fmt: skip
    """What to export, from a fit, a model, a table or a compressed one.

    name : of the material; default that of the table, or of the model.
    channels : of a model, with their wavelengths, which a fit does not keep.

    Raises SpecError for a model that no target can hold: one that transmits, or has ideal reflection.
    """
    from fitter.compression import CompressedTable

    if isinstance(source, Subject):
        return source
    if isinstance(source, CompressedTable):
        source = source.decompress()
    if isinstance(source, Table):
        return Subject(
            name or source.metadata.name or "table", source.channels, source.symmetry, table=source
        )
    from fitter.fitting import FitResult

    fit = source if isinstance(source, FitResult) else None
    model = source.model if isinstance(source, FitResult) else source
    _refuse_what_is_no_brdf(model)
    own = (
        tuple(channels) if channels is not None else tuple(Channel(c, _wavelength(c)) for c in model.channels)
    )
    if tuple(c.name for c in own) != model.channels:
        raise SpecError(
            f"the model's channels are {', '.join(model.channels)}", code="bad-channels", parameter="channels"
        )
    measured = None if fit is None else fit.table.get("name")
    return Subject(
        name or (f"{measured} as {model.spec.name}" if measured else model.spec.name), own,
        "isotropic" if type(model).isotropic(model.spec) else "anisotropic", model=model, fit=fit,
    )  # fmt: skip


def only(what: Subject, names: Sequence[str]) -> Subject:
    """The subject with these of its channels, in this order. Raises SpecError for one that it has not."""
    own = [channel.name for channel in what.channels]
    for name in names:
        if name not in own or list(names).count(name) > 1:
            what_is_wrong = "is not there" if name not in own else "is named twice"
            raise SpecError(
                f"the channel {name[:64]!r} {what_is_wrong}",
                code="bad-channels", parameter="channels", remedy=f"the channels are {', '.join(own)}",
            )  # fmt: skip
    index = [own.index(name) for name in names]
    chosen = tuple(what.channels[k] for k in index)
    if what.table is not None:
        return replace(what, channels=chosen, table=_columns(what.table, index, chosen))
    assert what.model is not None

    def of(value: Any) -> Any:
        return value[np.asarray(index)] if np.ndim(value) else value

    values = {name: of(value) for name, value in what.model.values.items()}
    model = type(what.model)(spec=what.model.spec, channels=tuple(names), values=values)
    fit = what.fit
    if fit is not None:
        estimates = {
            name: replace(
                e, value=of(e.value), standard_uncertainty=of(e.standard_uncertainty),
                degrees_of_freedom=of(e.degrees_of_freedom),
                at_bound=tuple(e.at_bound[k] for k in index) if np.ndim(e.value) else e.at_bound,
            )
            for name, e in fit.parameters.items()
        }  # fmt: skip
        fit = replace(fit, model=model, parameters=estimates)
    return replace(what, channels=chosen, model=model, fit=fit)


def _columns(table: Table, index: list[int], channels: tuple[Channel, ...]) -> Table:
    """The table with these columns; what is usable stays so."""
    directions: dict[str, Any] = {"grid": table.grid} if table.grid else {"wi": table.wi, "wo": table.wo}
    sigma = None if table.sigma is None else table.sigma[:, index]
    return Table(
        **directions, value=table.value[:, index], sigma=sigma, channels=channels, mask=table.mask,
        symmetry=table.symmetry, metadata=table.metadata, negatives="keep", duplicates="keep",
    )  # fmt: skip


def _wavelength(channel: str) -> float | None:
    """The wavelength in nm of a channel that is named by it ("550nm"), as readers name them."""
    text = channel.removesuffix("nm").strip()
    if text == channel:
        return None
    try:
        return float(text)
    except ValueError:
        return None


def _refuse_what_is_no_brdf(model: ReflectanceModel) -> None:
    import jax.numpy as jnp

    kind = type(model)
    up = (jnp.zeros(()), jnp.zeros(()), jnp.ones(()))
    what = None
    if kind.transmits(model.spec):
        what = "transmits light"
    elif kind.deltas(model.spec, model.values, *up):
        what = "has an ideal mirror component, which has no value in 1/sr"
    if what is not None:
        raise SpecError(
            f"{model.spec.name} {what}: no target here holds that", code="export-not-a-brdf",
            parameter="model", remedy="export the other components, as a model of their own",
        )  # fmt: skip
