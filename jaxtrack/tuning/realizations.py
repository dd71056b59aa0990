"""A loss of one realization on many: its mean, and its gradient, by the Monte Carlo engine."""

import functools
from collections.abc import Callable
from typing import Any

import jax

from jaxtrack.montecarlo import MonteCarlo, monte_carlo
from jaxtrack.types import Array, Key


def mean_loss(
    loss: Callable[[Any, Key], Array],
    params: Any,
    *,
    key: Key,
    realizations: int,
    micro_batch: int = 8,
    batch_params: bool = False,
) -> MonteCarlo:
    """Return a loss over realizations, its mean and its standard error, as `fit` evaluates it.

    Args:
        loss: `(params, key) -> []`, as `fit` takes it; what `fit` compiled of it is used again.
        params: where.
        key: of the realizations; `fit` has streams of its own, so any key gives others.
        realizations: how many.
        micro_batch: realizations under one `vmap`.
        batch_params: parameters have a leading axis [P]: P losses on the same realizations.

    Example:
        >>> squared = lambda x, key: (x - jax.random.normal(key)) ** 2
        >>> run = mean_loss(squared, 0.0, key=jax.random.key(0), realizations=1000)
        >>> abs(float(run.mean) - 1.0) < 5 * float(run.standard_error)
        True
    """
    value, _ = programs(loss)
    return monte_carlo(
        value, key, realizations, params, micro_batch=micro_batch, batch_params=batch_params
    )


@functools.lru_cache(maxsize=64)
def programs(loss: Callable[[Any, Key], Array]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the loss, and loss and gradient, as `monte_carlo` takes them: once for a loss.

    The gradient is that in the parameters themselves: so the same program serves all bijectors.
    """

    def value(key: Key, params: Any) -> Array:
        return loss(params, key)

    def slope(key: Key, params: Any) -> tuple[Array, Any]:
        return jax.value_and_grad(loss)(params, key)

    return value, slope
