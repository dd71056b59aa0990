"""Losses of one realization, smooth in what is tuned, and their mean over many.

Of sets of targets: `ospa` and `gospa` as `jaxtrack.metrics` has them, whose assignment is exact
and whose gradient is that of the assignment at hand; `sinkhorn_ospa` and `sinkhorn_gospa`, smooth
where those have kinks, with a bound of the difference. Of votes: `candidate_softmax`. Of filters:
`negative_log_likelihood`. Of gates: `false_track_loss`.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack.metrics import gospa, ospa
from jaxtrack.montecarlo import MonteCarlo, monte_carlo
from jaxtrack.numerics.checks import check_array, check_known, check_mask, check_positive
from jaxtrack.numerics.masked import masked_logsumexp, masked_mean, masked_sum
from jaxtrack.numerics.safe import as_float
from jaxtrack.tuning.sinkhorn import SinkhornDistance, sinkhorn_gospa, sinkhorn_ospa
from jaxtrack.types import Array, Key

__all__ = [
    "SinkhornDistance",
    "candidate_softmax",
    "false_track_loss",
    "gospa",
    "mean_loss",
    "negative_log_likelihood",
    "ospa",
    "sinkhorn_gospa",
    "sinkhorn_ospa",
]


def candidate_softmax(scores: Array, mask: Array, near: Array, *, temperature: Any = 1.0) -> Array:
    """Measure how far the candidates near each target stand out from those near none.

        L = −mean_k log(Σ_{c near k} exp(s_c / T) / Σ_{c near k, or near none} exp(s_c / T))

    Targets without a candidate nearby are left out: no score helps them. Without any L = 0.

    Args:
        scores: [C] of the candidates: their votes, as a rule.
        mask: [C] which of them exist.
        near: [C, K] which are near which target, as by `metrics.line_distance`.
        temperature: T > 0, in the unit of the scores: as T vanishes L becomes the mean shortfall,
            over T, of the targets' best candidates against the best false one.

    Raises:
        ValueError: shapes do not fit, or a known temperature that is not positive.
        TypeError: not real numbers, or masks that are none.

    Example:
        >>> near = jnp.array([[True], [False], [False]])
        >>> loss = candidate_softmax(jnp.array([3.0, 1.0, 1.0]), jnp.ones(3, bool), near)
        >>> print(f"{loss:.4f} {jnp.log1p(2 * jnp.exp(-2.0)):.4f}")
        0.2395 0.2395
    """
    check_array("scores", scores, shape=("C",))
    check_mask("mask", mask, shape=jnp.shape(scores))
    check_mask("near", near, shape=(*jnp.shape(scores), "K"))
    check_array("temperature", temperature, shape=())
    scores = as_float(scores)
    temperature = check_positive("temperature", temperature, scores.dtype)
    own = (near & mask[:, None]).T  # [K, C]
    false = mask & ~near.any(axis=1)
    exponent = jnp.broadcast_to(jnp.where(mask, scores, 0.0) / temperature, own.shape)
    all_of_it = masked_logsumexp(exponent, own | false[None, :])
    some = own.any(axis=1)
    return masked_mean(jnp.where(some, all_of_it - masked_logsumexp(exponent, own), 0.0), some)


def negative_log_likelihood(log_likelihood: Array, seen: Array) -> Array:
    """Return a filter's negative log likelihood a look, from the info of a run.

        L = −Σ_t log p(z_t | z_1, …, z_{t−1}) / number of looks where the target was seen

    Args:
        log_likelihood: [T] of the looks, as the infos of `jaxtrack.filtering` have it.
        seen: [T] where there was a measurement; without any L = 0.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers, or a mask that is none.

    Example:
        >>> print(negative_log_likelihood(jnp.array([-2.0, -4.0, 0.0]), jnp.arange(3) < 2))
        3.0
    """
    check_array("log_likelihood", log_likelihood, shape=("T",))
    check_mask("seen", seen, shape=jnp.shape(log_likelihood))
    return -masked_mean(log_likelihood, seen)


def false_track_loss(
    gate: Any, votes: Array, mask: Array, *, false_per_run: Any, temperature: Any = None
) -> Array:
    """Return a loss whose mean is least where so many false tracks a run pass a gate.

        L(g) = Σ_m max(v_m − g, 0) + g F,   dL/dg = F − #{v_m > g}

    over the tracks of a scene without targets. It is convex in g, and each realization's gradient
    is an unbiased look at the rate, so `fit` needs no scenes kept in store. On a fixed set of
    scenes the least L is at `hough.gate_for_false_rate`.

    Args:
        gate: [] g.
        votes: [M] votes or scores of the tracks found; they carry no gradient, for a gate is set
            for votes as they are.
        mask: [M] which tracks exist.
        false_per_run: F, the wanted mean number of tracks above the gate.
        temperature: None, or T > 0 in the unit of the votes: the steps of the gradient become
            sigmoids of this width.

    Raises:
        ValueError: shapes do not fit, or a known value that cannot be.
        TypeError: not real numbers, or a mask that is none.

    Example:
        >>> votes = jnp.array([9.0, 4.0, 2.0])
        >>> there = jnp.ones(3, bool)
        >>> slope = jax.grad(lambda g: false_track_loss(g, votes, there, false_per_run=0.5))
        >>> print(slope(3.0), slope(20.0))
        -1.5 0.5

    Source:
        R. Koenker and G. Bassett, "Regression Quantiles", 1978, for a number instead of a share.
    """
    check_array("gate", gate, shape=())
    check_array("votes", votes, shape=("M",))
    check_mask("mask", mask, shape=jnp.shape(votes))
    check_array("false_per_run", false_per_run, shape=())
    check_known("false_per_run", false_per_run, lambda f: f > 0, "a number above 0")
    votes = jax.lax.stop_gradient(jnp.where(mask, as_float(votes), 0.0))
    gate = jnp.asarray(gate, votes.dtype)
    above = votes - gate
    if temperature is None:
        excess = jnp.where(above > 0, above, 0.0)
    else:
        temperature = check_positive("temperature", temperature, votes.dtype)
        excess = temperature * jax.nn.softplus(above / temperature)
    return masked_sum(excess, mask) + gate * jnp.asarray(false_per_run, votes.dtype)


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
    value = lambda key, params: loss(params, key)
    slope = lambda key, params: jax.value_and_grad(loss)(params, key)
    return value, slope
