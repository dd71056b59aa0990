"""Monte Carlo: any function of a key, run for thousands of trials, with standard errors.

    key of trial t = jax.random.fold_in(key, t)

so trials can be run in any order, in parts and on any machine. Promised, at the recorded
`micro_batch`, dtype, jaxlib and kind of processor: results are equal bit for bit for any number of
devices and processes and wherever a run was interrupted. Across micro-batches the draws are equal
and continuous results agree to 1e-10 (float64) or 1e-4 (float32); a discrete decision may flip in
a rare trial.

On a CPU each core can be a device; say so before anything else uses JAX:

    jax.config.update("jax_num_cpu_devices", 8)

Example:
    >>> import jax
    >>> from jaxtrack.montecarlo import monte_carlo, proportion_interval
    >>> def detected(key, snr):
    ...     return jax.random.normal(key) + snr > 2.0
    >>> run = monte_carlo(detected, jax.random.key(0), trials=400, params=3.0)
    >>> lower, upper = proportion_interval(run.values.sum(), run.trials)
    >>> bool(lower < 0.841 < upper)
    True
"""

from jaxtrack.montecarlo.engine import MonteCarlo, monte_carlo
from jaxtrack.montecarlo.statistics import (
    Interval,
    interval_of_mean,
    mean_and_error,
    proportion_interval,
)

__all__ = [
    "Interval",
    "MonteCarlo",
    "interval_of_mean",
    "mean_and_error",
    "monte_carlo",
    "proportion_interval",
]
