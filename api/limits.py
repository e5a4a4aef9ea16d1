"""Limits: request bodies are cut where they pass the limit, and posteriors at their size."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.problems import Problem
from api.settings import Settings
from fitter.spec import CalibrationSpec, PosteriorSpec


def check_posterior(spec: PosteriorSpec, settings: Settings) -> None:
    """Raises Problem (422) where a posterior is asked for that is larger than the server makes them."""
    _within("walkers", spec.ensembles * (spec.walkers or 1), settings.max_walkers)
    _within("keep", spec.keep, settings.max_kept_draws)
    _within("budget_seconds", spec.budget_seconds, settings.max_budget_seconds)


def bounded_calibration(spec: CalibrationSpec, settings: Settings) -> CalibrationSpec:
    """A calibration that ends in the time of a posterior. Raises Problem (422) where more is asked for."""
    check_posterior(spec.posterior, settings)
    most = settings.max_budget_seconds
    _within("time_limit_seconds", spec.time_limit_seconds or 0.0, most)
    return spec.model_copy(update={"time_limit_seconds": spec.time_limit_seconds or most})


def _within(parameter: str, asked: float, most: float) -> None:
    if asked > most:
        raise Problem.invalid(
            "beyond-limit", f"{parameter} comes to {asked:g}, the limit is {most:g}", parameter=parameter,
            remedy="ask for less, or have the server's operator raise the limit",
        )  # fmt: skip


#: What multipart framing may add to a file.
FRAMING = 64 << 10


class BodyLimit:
    """Middleware that raises 413 out of the reading of a body that is, or says it is, too long."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._settings = settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        uploading = scope["path"] == "/v1/tables"
        limit = self._settings.max_upload_bytes if uploading else self._settings.max_body_bytes
        bound = limit + FRAMING if uploading else limit
        claimed = dict(scope["headers"]).get(b"content-length", b"0")
        seen = 0

        async def counted() -> Message:
            nonlocal seen
            if claimed.isdigit() and int(claimed) > bound:
                raise Problem.too_large(limit)
            message = await receive()
            if message["type"] == "http.request":
                seen += len(message.get("body", b""))
                if seen > bound:
                    raise Problem.too_large(limit)
            return message

        await self._app(scope, counted, send)
