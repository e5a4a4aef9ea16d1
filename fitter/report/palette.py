"""Colours of channels and marks."""

from __future__ import annotations

from collections.abc import Sequence

#: Okabe and Ito's palette, told apart by people with any of the common colour deficiencies.
BLUE, VERMILLION, GREEN, PURPLE = "#0072b2", "#d55e00", "#009e73", "#cc79a7"
_ORDER = (BLUE, VERMILLION, GREEN, PURPLE)
_NAMED = {"R": VERMILLION, "G": GREEN, "B": BLUE}


def colours(channels: Sequence[str]) -> dict[str, str]:
    """A colour per channel, at most four; R, G and B keep their own."""
    if set(channels) <= set(_NAMED):
        return {name: _NAMED[name] for name in channels}
    return dict(zip(channels, _ORDER, strict=False))
