"""Decisions in words and as documents: each in a sentence with its number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fitter.scene.effects import WORDS
from fitter.scene.search import Decision

#: Errors beyond this are those of a limit.
_LIMIT = 1e9


def judged(
    name: str, effect: str, found: Decision, gone: bool, saved: float, full: float, degrees: float,
    free: Sequence[str],
) -> dict[str, Any]:  # fmt: skip
    words = WORDS[effect]
    if gone:
        sentence = (
            f"{words} of {name} off: directions stay within {degrees:.0f} degrees of the normal, "
            f"error <= {100 * found.bound:.2g} %"
        )
    elif found.state == "bounded" and effect not in free:
        sentence = f"{words} of {name} kept: leaving it out saves nothing"
    elif found.state == "bounded":
        sentence = f"{words} of {name} kept: with what else is left out it would exceed the tolerance"
    else:
        sentence = f"{words} of {name} kept: {reason(found)}"
    return {
        **decision(effect, name, found, gone, sentence), "saved_operations": saved,
        "material_operations": full,
    }  # fmt: skip


def percent(share: float) -> str:
    """Two digits, or whole percents."""
    return f"{100 * share:.2g} %" if share < 0.095 else f"{100 * share:,.0f} %"


def reason(found: Decision) -> str:
    if found.state == "needed" and found.found > _LIMIT:
        return "without it nothing limits the error towards a rim"
    if found.state == "needed":
        return f"without it a point is {percent(found.found)} off"
    if found.state == "bounded":
        return f"with what else is left out its {100 * found.bound:.2g} % would be too much"
    bound = "without bound" if not np.isfinite(found.bound) else f"up to {100 * found.bound:.2g} %"
    return f"not proved ({bound} after {found.boxes} boxes)"


def decision(effect: str, subject: str, found: Decision, gone: bool, sentence: str) -> dict[str, Any]:
    return {
        "effect": effect, "subject": subject, "off": gone, "state": found.state,
        "bound": found.bound if np.isfinite(found.bound) else None, "found": found.found,
        "boxes": found.boxes, "sentence": sentence,
    }  # fmt: skip


def kept(subject: str, effect: str, sentence: str) -> dict[str, Any]:
    """Of what nothing is proved."""
    return {
        "effect": effect, "subject": subject, "off": False, "state": "not-bounded", "bound": None,
        "found": 0.0, "boxes": 0, "sentence": sentence,
    }  # fmt: skip
