"""The outcome of a comparison in words: which model, whether it is good enough, and what limits it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from fitter.selection.compare import TOLERATED
from fitter.selection.data import Data
from fitter.selection.result import Ranked, RawTable, Verdict

#: How much better the raw table has to predict held-out samples, beyond doubt, before a model is given up for
#: it: a model also extrapolates, is smooth, and has parameters.
WORTH_THE_TABLE = 1.25
#: Error over noise up to which the misfit is no larger than the noise.
AT_NOISE = math.sqrt(2.0)


@dataclass(frozen=True)
class Facts:
    """What the sentences are made of; ``noise_ratio`` : error of the chosen model over that of the noise."""

    data: Data
    ranking: Sequence[Ranked]
    chosen: Ranked
    raw: RawTable | None
    raw_reason: str | None
    noise_ratio: float | None

    @property
    def held_out(self) -> bool:
        return self.data.blocks.kind is not None


def verdict(facts: Facts) -> Verdict:
    """Whether the chosen model is good enough to be used in place of the table."""
    if facts.noise_ratio is not None and facts.noise_ratio <= AT_NOISE:
        return "model"
    if facts.raw is None:
        return "not_judged"
    found = facts.raw.model_over_raw
    return "raw_table" if found.lower > 1.0 and found.ratio > WORTH_THE_TABLE else "model"


def sentences(facts: Facts) -> tuple[str, ...]:
    """The choice, the verdict, and what limits them."""
    return (_choice(facts), _verdict(facts), *_limits(facts))


def _choice(facts: Facts) -> str:
    chosen, ranking = facts.chosen, facts.ranking
    count = len(ranking)
    what = "predicts held-out samples" if facts.held_out else "fits its samples"
    text = (
        f"Of {count} model{'s' if count != 1 else ''}, {chosen.model} ({_parameters(chosen)}) is chosen: it "
        f"{what} to {_percent(chosen.relative_error)} (median relative error)"
    )
    best = ranking[0]
    if not facts.held_out:
        rest = [one for one in ranking if one is not chosen]
        if rest:
            text += (
                "; of the models with the smallest information criterion it is the simplest, and that of "
                f"the next, {rest[0].model}, is {_more(rest[0], chosen)}"
            )
        return text + "."
    if best is not chosen:
        assert chosen.against_best is not None
        return (
            f"{text}. The smallest error is that of {best.model} ({_parameters(best)}), but by no more than "
            f"one standard error or 1 %: the chosen one's is {_ratio(chosen)} times it."
        )
    rival = next((one for one in ranking if one is not chosen and one.held_out), None)
    if rival is not None:
        text += f"; the next, {rival.model}, has {_ratio(rival)} times its error"
    elif count > 1 and all(one.error > (1.0 + TOLERATED) * best.error for one in ranking[1:]):
        text += "; every other model misses even the samples that it was fitted to by more"
    return text + "."


def _verdict(facts: Facts) -> str:
    raw, noise = facts.raw, facts.noise_ratio
    if noise is not None and noise <= AT_NOISE:
        return (
            f"Its error is {noise:.3g} times that of the noise alone: the table says no more than the model."
        )
    beyond = "" if noise is None else f" Its error is {noise:.3g} times that of the noise alone."
    if raw is None:
        why = facts.raw_reason or "the table can't be held out like a model"
        return f"Whether it is good enough to replace the table can't be said: {why}.{beyond}"
    found = raw.model_over_raw
    numbers = (
        f"of held-out samples {facts.chosen.model} has {found.ratio:.3g} times the error of the table's own "
        f"interpolant, {raw.words} (95 % interval {found.lower:.3g} to {found.upper:.3g}; median relative "
        f"errors {_percent(raw.relative_error_of_model)} and {_percent(raw.relative_error)})"
    )
    if verdict(facts) == "raw_table":
        missed = _percent(raw.relative_error_of_model)
        return f"No model is good enough, use the raw table where {missed} matter: {numbers}.{beyond}"
    closer = raw.relative_error * WORTH_THE_TABLE < raw.relative_error_of_model
    typical = " A typical sample is closer to the interpolant than to the model." if closer else ""
    if found.upper < 1.0:
        return f"It is better than the table itself: {numbers}.{typical}{beyond}"
    return f"The table itself is not clearly better: {numbers}.{typical}{beyond}"


def _limits(facts: Facts) -> list[str]:
    data = facts.data
    if not facts.held_out:
        reason = {
            "one incidence": "The table has one incidence only",
        }.get(data.blocks.words, "The table has too few directions to hold some of them out")
        return [
            f"{reason}: no scan can be held out, and models are compared by an information criterion alone. "
            "How they depend on what was not measured is an extrapolation."
        ]
    found = [
        f"Held out: {data.blocks.words}. The folds share most of what is fitted to, so the intervals are "
        "approximate and typically too narrow; outside the measured angles nothing is promised."
    ]
    if data.table.domain.in_plane:
        found.append("The table lies in the plane of incidence: outside it no model was tested.")
    if not data.whole:
        found.append(
            f"Compared on {len(data.rows):,} of {len(data.used):,} samples, from each block its share."
        )
    return found


def _ratio(one: Ranked) -> str:
    found = one.against_best
    assert found is not None
    return f"{found.ratio:.3f} (95 % interval {found.lower:.3f} to {found.upper:.3f})"


def _parameters(one: Ranked) -> str:
    return f"{one.parameters} parameter{'s' if one.parameters != 1 else ''}"


def _more(one: Ranked, other: Ranked) -> str:
    delta = one.information_criterion - other.information_criterion
    return f"{abs(delta):.3g} {'larger' if delta >= 0 else 'smaller'}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"
