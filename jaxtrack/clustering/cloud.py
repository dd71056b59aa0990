"""C-means on clouds (`cloud_model`): classes that are both fuzzy and random, found from samples."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.clustering.cloud_model import (
    Cloud,
    backward,
    floored_spread,
    forward,
    log_certainty,
    mean_log_certainty,
)
from jaxtrack.numerics.checks import check_array, check_size
from jaxtrack.numerics.safe import safe_divide
from jaxtrack.types import Array

__all__ = [
    "Cloud",
    "CloudMeans",
    "backward",
    "cloud_cmeans",
    "floored_spread",
    "forward",
    "log_certainty",
    "mean_log_certainty",
]


class CloudMeans(NamedTuple):
    """What C-means on clouds found."""

    cloud: Cloud  # [K] in front
    members: Array  # [K, N] share of each sample in each class: 0 or 1, or soft
    certainty: Array  # [K, N] u; zero where a sample may not belong to a class
    objective: Array  # [] J
    done: Array  # [] False: the last iteration still changed J by more than the tolerance


def cloud_cmeans(
    samples: Array,
    weights: Array,
    start: Array,
    *,
    centres: Array,
    floor: Array,
    allowed: Array | None = None,
    xi: Array | None = None,
    temperature: Array | float | None = None,
    tolerance: Array | float = 1e-6,
    iterations: int = 12,
) -> CloudMeans:
    """Return classes of samples, each a cloud: C-means with certainties for memberships.

    Samples go to the class in which they are most certain, each class becomes the cloud of its
    samples, which gives new certainties, until the objective stands still:

        J = Σ_ij w_j u_ij² ‖z_j − Ex_i‖²

    Args:
        samples: [N, D].
        weights: [N] ≥ 0.
        start: [K, N] logarithms of the certainties to start from.
        centres: [K, D] where a class without samples stands.
        floor: [N, D] least width En' of a class, as each sample sees it; positive.
        allowed: [K, N] which samples a class may have; all by default.
        xi: [K, D] standard normal draws of the widths; the mean certainty without.
        temperature: if given, classes share samples by a softmax of log u / temperature, and all
            iterations are made, so that the result is smooth; it tends to the crisp one as the
            temperature goes to 0.
        tolerance: iterations end when J changes by less, in the samples' unit squared.
        iterations: at most so many. Static.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers, or `iterations` is not an int.

    Example:
        >>> samples = jnp.array([[0.0], [1.0], [10.0], [11.0]])
        >>> start = -jnp.abs(samples.T - jnp.array([[3.0], [7.0]]))
        >>> found = cloud_cmeans(samples, jnp.ones(4), start, centres=jnp.zeros((2, 1)),
        ...                      floor=jnp.ones((4, 1)))
        >>> print(found.cloud.expectation.ravel(), found.done)
        [ 0.5 10.5] True

    Source: clustering cloud-like model (2019), equations 2, 3, 11 and 12, steps 2 to 5.

    Note:
        The widths are drawn once, before the first iteration: drawn anew in each, the objective
        never settles in half of the cases. Step 5 returns to step 2 and not, as printed, to 1.
    """
    check_array("samples", samples, shape=("N", "D"))
    size, features = samples.shape
    check_array("weights", weights, shape=(size,))
    check_array("start", start, shape=("K", size))
    classes = start.shape[0]
    check_array("centres", centres, shape=(classes, features))
    check_array("floor", floor, shape=(size, features))
    check_size("iterations", iterations)
    allowed = jnp.ones((classes, size), bool) if allowed is None else allowed
    check_array("allowed", allowed, shape=(classes, size))
    if xi is not None:
        check_array("xi", xi, shape=(classes, features))
    dtype = samples.dtype
    bound = jnp.asarray(tolerance, dtype)

    def iterate(state: _State, _: None) -> tuple[_State, None]:
        members = _classes(state.log_u, allowed, temperature)
        cloud = jax.vmap(lambda share: backward(samples, weights * share))(members)
        empty = (cloud.mass <= 0)[:, None]
        cloud = cloud._replace(expectation=jnp.where(empty, centres, cloud.expectation))
        if xi is None:
            log_u = mean_log_certainty(samples, *cloud[:3], floor)
        else:
            width = floored_spread(cloud.entropy + cloud.hyper_entropy * xi, floor)
            log_u = log_certainty(samples, cloud.expectation, width)
        apart = ((samples[None] - cloud.expectation[:, None]) ** 2).sum(-1)
        u = jnp.where(allowed, jnp.exp(log_u), 0.0)
        objective = (weights[None, :] * u**2 * apart).sum()
        done = jnp.abs(jax.lax.stop_gradient(objective - state.objective)) < bound
        new = _State(log_u, cloud, members, u, objective, done)
        if temperature is not None:
            return new, None
        return jax.tree.map(lambda old, new: jnp.where(state.done, old, new), state, new), None

    nowhere = jnp.zeros((classes, features), dtype)
    nothing = jnp.zeros((classes, size), dtype)
    begin = _State(
        start.astype(dtype),
        Cloud(nowhere, nowhere, nowhere, jnp.zeros(classes, dtype)),
        nothing,
        nothing,
        jnp.asarray(jnp.inf, dtype),
        jnp.asarray(False),
    )
    last, _ = jax.lax.scan(iterate, begin, length=iterations)
    return CloudMeans(last.cloud, last.members, last.certainty, last.objective, last.done)


class _State(NamedTuple):
    log_u: Array
    cloud: Cloud
    members: Array
    certainty: Array
    objective: Array
    done: Array


def _classes(log_u: Array, allowed: Array, temperature: Array | float | None) -> Array:
    """Return the share [K, N] of every sample in every class; none where nothing is allowed."""
    some = allowed.any(0)[None, :]
    if log_u.shape[0] == 0:
        return jnp.zeros_like(log_u)
    lowest = jnp.asarray(jnp.finfo(log_u.dtype).min / 4, log_u.dtype)
    known = jnp.where(allowed, log_u, lowest)
    if temperature is None:
        best = jnp.argmax(known, axis=0)
        share = (jnp.arange(log_u.shape[0])[:, None] == best[None, :]).astype(log_u.dtype)
    else:
        scaled = known / jnp.asarray(temperature, log_u.dtype)
        peak = jnp.where(allowed, jax.lax.stop_gradient(scaled), -jnp.inf).max(0)
        shifted = jnp.where(allowed, scaled - jnp.where(some[0], peak, 0.0)[None, :], 0.0)
        power = jnp.where(allowed, jnp.exp(shifted), 0.0)
        share = safe_divide(power, power.sum(0)[None, :])
    return jnp.where(some, share, 0.0)
