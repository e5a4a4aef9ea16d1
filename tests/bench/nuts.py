"""NUTS of a well-kept package on a posterior's own density, where the package is installed."""

from __future__ import annotations

import importlib.util
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitter.fitting.layout import layout
from fitter.fitting.result import FitResult
from fitter.fitting.usable import usable
from fitter.posterior.density import GAUSSIAN, Data, log_likelihood
from fitter.posterior.diagnostics import diagnose
from fitter.table import Table

FloatArray = NDArray[np.float64]
CHAINS, WARMUP = 4, 300


def installed() -> bool:
    """Whether blackjax is there: it is nobody's dependency here (``pip install blackjax``)."""
    return importlib.util.find_spec("blackjax") is not None


def rate(table: Table, fit: FitResult, seed: int, steps: int) -> dict[str, float]:
    """Effective samples a second of the worst parameter, and processor seconds for one, while sampling:
    compiling and the adaptation of mass matrix and step size, which ours has to pay for, are not counted.

    Linear parameters go by their logarithm, with its Jacobian: the same posterior, without a wall.
    """
    blackjax: Any = importlib.import_module("blackjax")
    places = layout(fit.spec, len(table.channels))
    data = usable(table, "absolute", fit.spec.select, anisotropic=True)
    assert data.sigma is not None
    held = jax.device_put(Data(data.pair, data.value.T.copy(), data.sigma.T.copy()))
    count = len(places.linear) * len(data.channels)

    def log_density(x: Any) -> Any:
        y = jnp.concatenate([jnp.exp(x[:count]), x[count:]])
        return log_likelihood(places, GAUSSIAN, y, held) + jnp.sum(x[:count])

    linear = np.concatenate([fit.parameters[p.name].value for p in places.linear])
    values = {name: e.value for name, e in fit.parameters.items()}
    start = np.concatenate([np.log(linear), places.search_vector(values, range(len(data.channels)))])
    adaptation: Any = blackjax.window_adaptation(blackjax.nuts, log_density)
    (state, settings), _ = adaptation.run(jax.random.key(seed), jnp.asarray(start), num_steps=WARMUP)
    step = blackjax.nuts(log_density, **settings).step

    @jax.jit
    def chain(key: Any) -> Any:
        def one(state: Any, key: Any) -> Any:
            state, _ = step(key, state)
            return state, state.position

        return jax.lax.scan(one, state, jax.random.split(key, steps))[1]

    keys = jax.random.split(jax.random.key(seed + 1), CHAINS + 1)
    jax.block_until_ready(chain(keys[-1]))
    wall, cpu = time.perf_counter(), time.process_time()
    found = np.stack([np.asarray(chain(key)) for key in keys[:CHAINS]])
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    diagnostics = diagnose(found)
    ess = min(min(d.ess_bulk, d.ess_tail) for d in diagnostics)
    return {"rate": ess / wall, "cpu": cpu / ess, "rhat": max(d.rhat for d in diagnostics), "ess": ess}
