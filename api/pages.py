"""Pages for people: the front page, and the API's documentation with nothing fetched from outside."""

from __future__ import annotations

from html import escape
from importlib.resources import files
from pathlib import Path

from fastapi import APIRouter, FastAPI, Request
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse
from fastapi.staticfiles import StaticFiles

import fitter

_FRONT = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>brdf-fitter</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>body{{font:16px/1.5 system-ui,sans-serif;max-width:42rem;margin:3rem auto;padding:0 1rem}}
code,pre{{background:#f3f3f3;padding:.1em .3em}}pre{{padding:1em;overflow:auto}}</style></head><body>
<h1>brdf-fitter {version}</h1>
<p>Fits reflectance models to measured BRDF tables, with uncertainties.</p>
<pre>curl --data-binary @paint.astm {base}v1/tables
curl --json '{{"table": "ID", "models": ["ward", "torrance_sparrow"]}}' {base}v1/fits</pre>
<ul><li><a href="docs">What every operation takes and gives</a> (<a href="openapi.json">OpenAPI</a>)</li>
<li><a href="v1/tables">Tables</a>, <a href="v1/jobs">jobs</a>, <a href="v1/fits">fits</a>,
<a href="v1/models">models</a>, <a href="v1/model-families">model families</a></li>
<li><a href="healthz">Health</a>, <a href="metrics">metrics</a></li></ul>
</body></html>
"""


def install(app: FastAPI) -> None:
    """Add ``/``, ``/docs`` and the script and style that the latter needs."""
    router = APIRouter(include_in_schema=False)

    @router.get("/")
    def front(request: Request) -> HTMLResponse:
        # The host name is the client's word.
        return HTMLResponse(_FRONT.format(version=fitter.__version__, base=escape(str(request.base_url))))

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
