"""Optuna's tree-structured Parzen estimator on a loss of simulated realizations, at fit's budget.

It spends realizations as `tuning.fit` does: so many fresh ones a try, and every so many tries its
best try so far is evaluated on the held-out ones, which choose what it returns.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxtrack.types import Key

_FRESH, _HELD_OUT, _SAMPLER = 0, 1, 2  # streams of random keys


class Search(NamedTuple):
    """T tries were made and E evaluations, the first of the start alone."""

    tried: dict[str, np.ndarray]  # [T] by name
    loss: np.ndarray  # [T] mean over a try's realizations
    best: np.ndarray  # [E] which try was evaluated
    held_out: np.ndarray  # [E] its mean loss on the held-out realizations


def is_installed() -> bool:
    """Tell whether there is an Optuna to search with."""
    try:
        import optuna  # noqa: F401
    except ImportError:
        return False
    return True


def search(
    mean: Callable[[Mapping[str, float], Key, int], Any],
    start: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
    *,
    key: Key,
    steps: int,
    batch: int,
    holdout: int,
    every: int,
    progress: Callable[[int, int], None],
) -> Search:
    """Search for the parameters with the least mean loss, all of them positive.

    Args:
        mean: `(params, key, realizations) -> []`, the mean loss.
        start: the first try.
        bounds: least and largest value of each parameter; drawn on a logarithmic scale.
        key: of all realizations, and of the sampler.
        steps: how many tries.
        batch: realizations a try, new ones each time.
        holdout: realizations of every evaluation, always the same.
        every: tries between evaluations.
        progress: called as `progress(tries done, steps)`.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    seed = int(jax.random.randint(jax.random.fold_in(key, _SAMPLER), (), 0, 2**31 - 1))
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed))
    study.enqueue_trial(dict(start))
    distributions: dict[str, Any] = {
        name: optuna.distributions.FloatDistribution(low, high, log=True)
        for name, (low, high) in bounds.items()
    }
    fresh, held_out = (jax.random.fold_in(key, stream) for stream in (_FRESH, _HELD_OUT))
    tried: list[dict[str, float]] = []
    losses: list[float] = []
    best, means = [], []

    def evaluate(number: int) -> None:
        best.append(number)
        means.append(float(mean(tried[number], held_out, holdout)))

    for done in range(1, steps + 1):
        trial = study.ask(distributions)
        tried.append(dict(trial.params))
        losses.append(float(mean(tried[-1], jax.random.fold_in(fresh, done), batch)))
        study.tell(trial, losses[-1])
        if done == 1:
            evaluate(0)
        if done % every == 0 or done == steps:
            evaluate(int(np.nanargmin(losses)))
        progress(done, steps)
    table = {name: np.array([params[name] for params in tried]) for name in start}
    return Search(table, np.array(losses), np.array(best), np.array(means))
