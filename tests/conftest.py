"""Shared fixtures. Tests that need the measured tables find them beside the project and skip loudly."""

from __future__ import annotations

import gc
import itertools
import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

import tests.typecheck  # noqa: F401 (the hook names it by its place)

ROOT = Path(__file__).resolve().parent.parent

# Compiled programs are shared by the test processes and by the commands they start. JAX reads this once, when
# it is first imported.
os.environ["XDG_CACHE_HOME"] = str(ROOT / ".cache")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".cache" / "brdf-fitter" / "xla"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "0")

from fitter._jax import compile_sooner  # noqa: E402
from fitter.memory_maps import forget_when_many  # noqa: E402

# Before anything imports them: shapes and types of the numerics' arguments are checked at every call.
# Not the requests themselves (fit, FitSpec): their own errors are what is tested.
KERNELS = ("separable", "polish", "metrics", "covariance", "beam", "samples", "blocks", "usable")
install_import_hook(
    [
        "fitter.models", "fitter.directions", "fitter.grid", "fitter.masking", "fitter.table",
        *(f"fitter.fitting.{kernel}" for kernel in KERNELS),
    ],
    "tests.typecheck.checked",
)  # fmt: skip

settings.register_profile(
    "project", deadline=None, max_examples=30, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("project")

# Half of a test is compiling what then runs for milliseconds: without LLVM's optimisations,
# and in one piece, since each core has a test process already. Benchmarks and studies compile as the product.
os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_parallel_codegen_split_count=1 --xla_backend_optimization_level=0"
)
compile_sooner()

# Traced programs are millions of objects that live long: looking through them again and again is a tenth of
# the time.
gc.set_threshold(100_000, 20, 100)

#: Tests between two looks at how many compiled programs there are.
LOOK_EVERY = 25
_tests = itertools.count(1)


def pytest_runtest_teardown() -> None:
    """Forget the compiled programs when they are many."""
    if next(_tests) % LOOK_EVERY == 0:
        forget_when_many()


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with measured tables and oracles (BRDF_SHARED, or ../shared beside the project)."""
    folder = Path(os.environ.get("BRDF_SHARED", ROOT.parent / "shared"))
    if not (folder / "measured").is_dir():
        pytest.skip(f"NO MEASURED TABLES: {folder} is not there (set BRDF_SHARED)")
    return folder
