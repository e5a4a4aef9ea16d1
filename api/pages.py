"""Pages for people: the page, and the API's documentation, with nothing fetched from outside."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from fastapi import APIRouter, FastAPI, Request
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse, Response
from fastapi.staticfiles import StaticFiles
from starlette.exceptions import HTTPException

import fitter
from api.assets import HEADERS, Assets


def install(app: FastAPI) -> None:
    """Add ``/`` with its files, and ``/docs`` with the script and style that it needs."""
    router = APIRouter(include_in_schema=False)
    assets = Assets()

    @router.get("/")
    def front() -> HTMLResponse:
        # It names its files by their content: whatever is older is asked for again.
        headers = {**HEADERS, "Cache-Control": "no-cache"}
        return HTMLResponse(assets.page(version=fitter.__version__), headers=headers)

    @router.get("/page/{digest}/{name:path}")
    def asset(digest: str, name: str, request: Request) -> Response:
        found = assets.get(name) if digest == assets.digest else None
        if found is None:
            raise HTTPException(404)
        kept = {"Cache-Control": "public, max-age=31536000, immutable", "Vary": "Accept-Encoding"}
        headers = {**HEADERS, **kept}
        content = found.content
        if "gzip" in request.headers.get("accept-encoding", "") and found.packed is not None:
            content, headers["Content-Encoding"] = found.packed, "gzip"
        return Response(content, media_type=found.media_type, headers=headers)

    @router.get("/docs")
    def docs() -> HTMLResponse:
        return get_swagger_ui_html(
            openapi_url="openapi.json", title=f"{app.title}: HTTP API",
            swagger_js_url="docs-assets/swagger-ui-bundle.js", swagger_css_url="docs-assets/swagger-ui.css",
            swagger_favicon_url="docs-assets/favicon.png",
            # Without this the page would send the schema's address to a validator on the internet.
            swagger_ui_parameters={"validatorUrl": None, "tryItOutEnabled": True},
        )  # fmt: skip

    app.include_router(router)
    # fastapi-offline ships Swagger UI's files; nothing else of it is used.
    app.mount("/docs-assets", StaticFiles(directory=Path(str(files("fastapi_offline"))) / "static"))
