"""The committed OpenAPI document: ``python -m tests.api.schema_snapshot`` writes docs/openapi.json anew."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from api.app import create_app
from api.settings import Settings

FILE = Path(__file__).resolve().parents[2] / "docs" / "openapi.json"


def text(document: dict[str, Any]) -> str:
    """Without the version, which changes by itself."""
    shown = {**document, "info": {**document["info"], "version": "0"}}
    return json.dumps(shown, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        FILE.write_text(text(create_app(Settings(folder=Path(folder))).openapi()))
    print(f"written: {FILE}")
