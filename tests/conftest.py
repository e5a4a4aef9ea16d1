"""Shared fixtures. Tests that need the measured tables find them beside the project and skip loudly."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "project", deadline=None, max_examples=30, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("project")

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with measured tables and oracles (BRDF_SHARED, or ../shared beside the project)."""
    folder = Path(os.environ.get("BRDF_SHARED", ROOT.parent / "shared"))
    if not (folder / "measured").is_dir():
        pytest.skip(f"NO MEASURED TABLES: {folder} is not there (set BRDF_SHARED)")
    return folder
