"""Candidates: the families and their nested forms, the plain ones first: they decide what else is tried."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fitter.spec import ModelSpec

#: Forms of a family are tried where its plain form's error is at most this many times the smallest.
REACH = 1.5
#: By how much a lobe has to lower the error for another to be worth a try.
WORTH = 0.01

#: Tried in any case.
PLAIN = (
    "lambert", "oren_nayar", "ward", "ward:bounded", "torrance_sparrow", "torrance_sparrow:ggx:smith",
    "lafortune", "lafortune:2",
)  # fmt: skip
#: Tried where one of the second names comes near the best.
FORMS: Mapping[str, tuple[str, ...]] = {
    "oren_nayar:full": ("oren_nayar",),
    "torrance_sparrow:smith": ("torrance_sparrow", "torrance_sparrow:ggx:smith"),
    "torrance_sparrow:ggx": ("torrance_sparrow", "torrance_sparrow:ggx:smith"),
}
#: Tried where the second name comes near the best, in a table that can tell.
SPECIAL: Mapping[str, tuple[str, ...]] = {
    "torrance_sparrow:none": ("torrance_sparrow",),
    "torrance_sparrow:ggx:none": ("torrance_sparrow:ggx",),
    "torrance_sparrow:smith:none": ("torrance_sparrow:smith",),
    "torrance_sparrow:ggx:smith:none": ("torrance_sparrow:ggx:smith",),
}
ANISOTROPIC: Mapping[str, tuple[str, ...]] = {
    "ward:anisotropic": ("ward",),
    "ward:bounded:anisotropic": ("ward:bounded",),
    "torrance_sparrow:anisotropic": ("torrance_sparrow",),
    "torrance_sparrow:ggx:smith:anisotropic": ("torrance_sparrow:ggx:smith",),
    "lafortune:anisotropic": ("lafortune",),
    "lafortune:anisotropic:2": ("lafortune:2",),
}
THREE_LOBES = "lafortune:3"


@dataclass(frozen=True)
class Skipped:
    """A model that was not tried, and why."""

    model: str
    reason: str


#: Errors of what was tried: name -> error of the fit to all samples, None where the fit is no candidate.
Errors = Mapping[str, float | None]
#: From the errors so far to what to try next, and what not to.
Stage = Callable[[Errors], tuple[list[str], list[Skipped]]]


def stages(azimuths: int) -> tuple[Stage, ...]:
    """The stages of an automatic comparison; ``azimuths`` : incident ones that the table has."""

    def plain(errors: Errors) -> tuple[list[str], list[Skipped]]:
        del errors
        return list(PLAIN), []

    def forms(errors: Errors) -> tuple[list[str], list[Skipped]]:
        wanted, skipped = _near(FORMS, errors)
        reason = _no_third_lobe(errors)
        if reason is None:
            wanted.append(THREE_LOBES)
        else:
            skipped.append(Skipped(THREE_LOBES, reason))
        return wanted, skipped

    def special(errors: Errors) -> tuple[list[str], list[Skipped]]:
        wanted, skipped = _near(SPECIAL, errors)
        if azimuths < FEWEST_AZIMUTHS:
            what = "one incident azimuth" if azimuths <= 1 else f"{azimuths} incident azimuths"
            why = f"the table has {what}: it can't tell anisotropic surfaces from isotropic ones"
            return wanted, skipped + [Skipped(name, why) for name in ANISOTROPIC]
        more, fewer = _near(ANISOTROPIC, errors)
        return wanted + more, skipped + fewer

    return plain, forms, special


#: Incident azimuths, half turns being the same, that determine two widths and a direction.
FEWEST_AZIMUTHS = 3


def model(name: str) -> ModelSpec:
    """The specification of a candidate's name."""
    return ModelSpec.parse(name)


def _near(forms: Mapping[str, tuple[str, ...]], errors: Errors) -> tuple[list[str], list[Skipped]]:
    best = min((error for error in errors.values() if error is not None), default=float("inf"))
    wanted: list[str] = []
    skipped: list[Skipped] = []
    for name, bases in forms.items():
        known = [error for base in bases if (error := errors.get(base)) is not None]
        base = " and ".join(bases)
        if not known:
            tried = [b for b in bases if b in errors]
            reason = f"{base} is no candidate itself" if tried else f"{base} was not tried"
            skipped.append(Skipped(name, reason))
        elif min(known) > REACH * best:
            reason = f"the error of {base} is {min(known) / best:.3g} times the smallest"
            skipped.append(Skipped(name, reason))
        else:
            wanted.append(name)
    return wanted, skipped


def _no_third_lobe(errors: Errors) -> str | None:
    """Why a third lobe is not worth its time (it is by far the dearest fit), or None."""
    one, two = errors.get("lafortune"), errors.get("lafortune:2")
    if two is None:
        return "two lobes are more than the table determines"
    best = min(error for error in errors.values() if error is not None)
    if one is None:
        return None
    gain = one / two
    if gain < 1.0 + WORTH:
        return f"a second lobe lowers the error by {max(gain - 1.0, 0.0):.1%} only"
    if two / gain > REACH * best:
        return (
            f"the error with two lobes is {two / best:.3g} times the smallest, and the second lobe lowered "
            f"it by a factor of {gain:.3g} only"
        )
    return None
