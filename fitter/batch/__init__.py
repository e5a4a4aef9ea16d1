"""Batch: many tables, one specification. What can be said before the work is said before it."""

from fitter.batch.comparing import Comparison, compare
from fitter.batch.estimating import Estimate, estimate
from fitter.batch.planning import Fetched, Plan, Unit, plan
from fitter.batch.running import Done, run
from fitter.batch.specification import SERVER, BatchSpec, batch_spec, read_spec, schema

__all__ = [
    "SERVER", "BatchSpec", "Comparison", "Done", "Estimate", "Fetched", "Plan", "Unit", "batch_spec",
    "compare", "estimate", "plan", "read_spec", "run", "schema",
]  # fmt: skip
