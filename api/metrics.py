"""Metrics: counters for Prometheus, in its text format."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"

_HELP = {
    "brdf_http_requests_total": "Requests answered, by method and status.",
    "brdf_upload_bytes_total": "Bytes of accepted tables.",
    "brdf_job_runs_total": "Runs of jobs, by kind and how they ended.",
    "brdf_job_seconds_total": "Seconds spent on jobs, by kind.",
}


class Metrics:
    """Counters since the server started."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counters: Counter[tuple[str, str]] = Counter()

    def request(self, method: str, status: int) -> None:
        # Only methods this service has: a label per invented word would grow without end.
        known = method if method in ("GET", "HEAD", "POST", "DELETE") else "other"
        self._add("brdf_http_requests_total", f'{{method="{known}",status="{status}"}}')

    def upload(self, size: int) -> None:
        self._add("brdf_upload_bytes_total", "", size)

    def job(self, kind: str, state: str, seconds: float) -> None:
        self._add("brdf_job_runs_total", f'{{kind="{kind}",state="{state}"}}')
        self._add("brdf_job_seconds_total", f'{{kind="{kind}"}}', seconds)

    def text(self, rows: Mapping[str, Mapping[str, int]]) -> str:
        """All counters, and how many rows there are (``rows``: kind -> state -> count)."""
        with self._lock:
            counted = sorted(self._counters.items())
        lines: list[str] = []
        for name, about in _HELP.items():
            lines += [f"# HELP {name} {about}", f"# TYPE {name} counter"]
            lines += [f"{name}{labels} {value:.15g}" for (owner, labels), value in counted if owner == name]
        for kind, states in rows.items():
            name = f"brdf_{kind}"
            lines += [f"# HELP {name} Rows kept.", f"# TYPE {name} gauge"]
            lines += [f'{name}{{state="{s}"}} {n}' if s else f"{name} {n}" for s, n in states.items()]
        return "\n".join(lines) + "\n"

    def _add(self, name: str, labels: str, amount: float = 1) -> None:
        with self._lock:
            self._counters[name, labels] += amount  # type: ignore[assignment]
