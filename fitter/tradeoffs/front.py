"""The Pareto front: what nothing beats in both what it costs and what it gets wrong."""

from __future__ import annotations

from collections.abc import Sequence


def front(costs: Sequence[float | None], errors: Sequence[float | None]) -> list[int]:
    """Positions of the points for which no other is as cheap and as exact, and better in one; cheapest first.

    Points without a cost or an error are on no front.
    """
    known = [
        (cost, error, k)
        for k, (cost, error) in enumerate(zip(costs, errors, strict=True))
        if cost is not None and error is not None
    ]
    found: list[int] = []
    best = float("inf")
    for _, error, k in sorted(known):
        if error < best:
            found.append(k)
            best = error
    return found
