"""The application: routes, errors and limits around one service."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from anyio import to_thread
from fastapi import FastAPI

import fitter
from api import openapi, pages, problems
from api.conditional import Conditional
from api.guard import Guard
from api.heads import Heads
from api.idempotency import Idempotent
from api.limits import BodyLimit
from api.observed import Observed
from api.routes import fit_views, fits, health, jobs, models, scenes, tables, tradeoffs, views
from api.service import Service
from api.settings import Settings

_ABOUT = """Upload a measured BRDF table, fit reflectance models to it, sample their posteriors, evaluate
and draw from fitted models or from the raw table. Whatever takes time is a job. Directions are unit vectors
away from the surface (z is the normal, x the sample's own axis), `wi` towards the light; values are
f_r in 1/sr without the cosine. Errors are problem documents (RFC 9457)."""


def create_app(settings: Settings) -> FastAPI:
    """The application; its service is opened when it starts and closed when it stops."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncGenerator[None]:
        service = await to_thread.run_sync(Service, settings)
        app.state.service = service
        await to_thread.run_sync(service.start)
        try:
            yield
        finally:
            await to_thread.run_sync(service.stop)

    app = FastAPI(
        title="brdf-fitter", version=fitter.__version__, description=_ABOUT, lifespan=lifespan, docs_url=None,
        redoc_url=None,
    )  # fmt: skip
    # The last one is the outermost.
    app.add_middleware(Idempotent)
    app.add_middleware(BodyLimit, settings=settings)
    app.add_middleware(Conditional)
    app.add_middleware(Guard, settings=settings)
    app.add_middleware(Heads)
    app.add_middleware(Observed)
    problems.install(app)
    for room in (tables, views, fits, fit_views, tradeoffs, scenes, jobs, models, health):
        app.include_router(room.router)
    pages.install(app)
    openapi.install(app, {**health.EXAMPLES, **models.EXAMPLES})
    return app
