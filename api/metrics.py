"""Metrics: what Prometheus scrapes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4

MEDIA_TYPE = CONTENT_TYPE_PLAIN_0_0_4
_METHODS = ("GET", "HEAD", "POST", "DELETE")
_SECONDS = (0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000, 3000, 10_000)
_SHARES = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)


class Metrics:
    """What this server has done since it started. Labels take their values from short lists only."""

    def __init__(self) -> None:
        self._registry = registry = CollectorRegistry()
        self._requests = Counter(
            "brdf_http_requests", "Requests answered.", ["method", "route", "status"], registry=registry
        )
        self._latency = Histogram(
            "brdf_http_request_seconds", "Until the answer had been sent.", ["route"], registry=registry,
            buckets=(0.005, 0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100),
        )  # fmt: skip
        self._problems = Counter("brdf_problems", "Errors answered.", ["code"], registry=registry)
        self._uploads = Counter("brdf_upload_bytes", "Bytes of accepted tables.", registry=registry)
        self._runs = Counter("brdf_job_runs", "Runs of jobs.", ["kind", "state"], registry=registry)
        self._seconds = Histogram(
            "brdf_job_seconds", "What a run of a job took.", ["kind"], registry=registry, buckets=_SECONDS
        )
        self._results = Counter(
            "brdf_results", "How solvers and samplers ended.", ["kind", "model", "status"], registry=registry
        )
        self._result_seconds = Histogram(
            "brdf_result_seconds", "What one fit or posterior took.", ["kind", "model"], registry=registry,
            buckets=_SECONDS,
        )  # fmt: skip
        self._acceptance = Histogram(
            "brdf_acceptance", "Accepted share of a sampler's proposals.", ["sampler"], registry=registry,
            buckets=_SHARES,
        )  # fmt: skip

    def request(self, method: str, route: str, status: int, seconds: float) -> None:
        # Only methods this service has: a label per invented word would grow without end.
        known = method if method in _METHODS else "other"
        self._requests.labels(known, route, status).inc()
        self._latency.labels(route).observe(seconds)

    def problem(self, code: str) -> None:
        self._problems.labels(code).inc()

    def upload(self, size: int) -> None:
        self._uploads.inc(size)

    def acceptance(self, sampler: str, share: float) -> None:
        """``sampler`` : "table", "model" or "posterior"."""
        self._acceptance.labels(sampler).observe(share)

    def job(self, kind: str, state: str, seconds: float, results: Sequence[Mapping[str, Any]]) -> None:
        """A run has ended; ``results`` as in the job's document."""
        self._runs.labels(kind, state).inc()
        self._seconds.labels(kind).observe(seconds)
        for one in results:
            if "model" not in one:
                continue
            # The family: names of forms and of sums are as many as clients think of.
            model = str(one["model"]).split(":")[0]
            status = "failed" if "problem" in one else str(one["status"])
            self._results.labels(one["kind"], model, status).inc()
            if "seconds" in one:
                self._result_seconds.labels(one["kind"], model).observe(one["seconds"])
            if "acceptance" in one:
                self.acceptance(one["kind"], one["acceptance"])

    def text(self, rows: Mapping[str, Mapping[str, int]]) -> bytes:
        """All of it, and how many rows there are (``rows``: kind -> state -> count)."""
        return generate_latest(self._registry) + generate_latest(_Rows(rows))  # pyright: ignore[reportArgumentType]


class _Rows:
    """How many rows there are now; jobs by state: ``brdf_jobs{state="queued"}`` is the queue's depth."""

    def __init__(self, rows: Mapping[str, Mapping[str, int]]) -> None:
        self._rows = rows

    def collect(self) -> Iterator[GaugeMetricFamily]:
        for kind, states in self._rows.items():
            labels = ["state"] if kind == "jobs" else []
            family = GaugeMetricFamily(f"brdf_{kind}", "Rows kept.", labels=labels)
            for state, count in states.items():
                family.add_metric([state] if labels else [], count)
            yield family
