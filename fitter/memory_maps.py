"""Memory maps: what a process that runs for long does about the compiled programs that gather in it."""

from __future__ import annotations

import gc
import logging
from pathlib import Path

_log = logging.getLogger("brdf_fitter")

_MAPS = Path("/proc/self/maps")
_MOST = Path("/proc/sys/vm/max_map_count")
#: The share of the maps that Linux grants a process above which compiled programs are forgotten.
SHARE = 0.6


def forget_when_many(share: float = SHARE) -> bool:
    """Forget the compiled programs when they take most of the memory maps that Linux grants; True if so.

    A program is mapped in a dozen pieces or more, a process may have 65,530 by default, and the compiler
    crashes beyond. What is needed again is loaded from the folder that keeps programs. Other systems than
    Linux have no such limit.
    """
    if not (_MAPS.exists() and _MOST.exists()):
        return False
    count = _MAPS.read_bytes().count(b"\n")
    if count <= share * int(_MOST.read_text()):
        return False
    import jax

    jax.clear_caches()
    gc.collect()
    _log.warning(
        "compiled programs forgotten: %d memory maps, now %d", count, _MAPS.read_bytes().count(b"\n")
    )
    return True
