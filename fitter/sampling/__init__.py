"""Random directions from models and from raw tables."""

from __future__ import annotations

from fitter.sampling.estimators import Moment, moment
from fitter.sampling.samples import Samples
from fitter.sampling.table_sampler import TableSampler

__all__ = ["Moment", "Samples", "TableSampler", "moment"]
