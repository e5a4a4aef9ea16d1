"""Rates: how often one caller may ask, by the generic cell rate algorithm (a leaky bucket in one number)."""

from __future__ import annotations

import math
import threading
import time
from collections import OrderedDict
from dataclasses import dataclass

#: Callers that are remembered; who was idle longest is forgotten, and may then ask anew.
_MOST = 10_000


@dataclass(frozen=True)
class Taken:
    """What one request leaves. retry_after : seconds to wait, 0 where the request may go on."""

    headers: dict[str, str]
    retry_after: int = 0


class Rates:
    """``burst`` requests at once, and ``per_second`` in the long run; 0 is no limit.

    In this process's memory: several servers allow as much each.
    """

    def __init__(self, per_second: float, burst: int) -> None:
        self._interval = 1 / per_second if per_second > 0 else 0.0
        self._burst = burst
        self._free_at: OrderedDict[str, float] = OrderedDict()
        self._lock = threading.Lock()
        self.words = f"{per_second:g} requests a second, or {burst} at once,"
        # The policy as draft-ietf-httpapi-ratelimit-headers says it: so many in a window of so many seconds.
        window = max(1, math.ceil(burst * self._interval))
        self._policy = f'"requests";q={burst};w={window}'

    def take(self, who: str, now: float | None = None) -> Taken | None:
        """Count one request of ``who``; None where there is no limit."""
        if not self._interval:
            return None
        now = time.monotonic() if now is None else now
        with self._lock:
            free_at = max(self._free_at.get(who, now), now)
            over = free_at + self._interval - (now + self._burst * self._interval)
            if over <= 1e-9:
                free_at += self._interval
                self._free_at[who] = free_at
                self._free_at.move_to_end(who)
                while len(self._free_at) > _MOST:
                    self._free_at.popitem(last=False)
        left = int((now + self._burst * self._interval - free_at) / self._interval + 1e-6)
        full_after = math.ceil(free_at - now)
        headers = {"RateLimit-Policy": self._policy, "RateLimit": f'"requests";r={left};t={full_after}'}
        return Taken(headers, 0 if over <= 1e-9 else max(1, math.ceil(over)))
