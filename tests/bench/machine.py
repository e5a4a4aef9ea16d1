"""Where and with what a benchmark ran."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

from fitter import __version__

ROOT = Path(__file__).resolve().parents[2]
LIBRARIES = ("numpy", "scipy", "jax", "jaxlib", "equinox", "optimistix", "emcee", "zstandard", "matplotlib")


def describe() -> dict[str, Any]:
    """JSON-ready: system, processor, cores, versions, commit."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "machine": {
            "system": f"{platform.system()} {platform.machine()}", "cpu": _cpu(), "cores": cores,
            "memory_gb": _memory(),
        },
        "versions": {"brdf-fitter": __version__, "python": platform.python_version()}
        | {name: importlib.metadata.version(name) for name in LIBRARIES},
        "commit": _git("rev-parse", "HEAD"),
        "uncommitted_changes": bool(_git("status", "--porcelain", "--", "fitter", "tests/bench")),
    }  # fmt: skip


def _cpu() -> str:
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        for line in listing.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"


def _memory() -> float | None:
    if not hasattr(os, "sysconf") or "SC_PHYS_PAGES" not in os.sysconf_names:
        return None
    return round(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30, 1)


def _git(*words: str) -> str | None:
    """What git says, or None outside a repository (an unpacked source archive)."""
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
