"""Where tracks start among detections of which a target may give several: one a neighbourhood."""

import jax.numpy as jnp

from jaxtrack.association import Predicted, gate
from jaxtrack.filtering.gaussian import Moments
from jaxtrack.numerics.checks import check_array
from jaxtrack.types import Array, Scan


def one_a_neighbourhood(
    started: Moments, weight: Array, mask: Array, limit: Array | float = 9.21
) -> Array:
    """Return which detections start a track, where those near each other may be one target's.

        d²_ik = (x_i − x_k)ᵀ (P_i + P_k)⁻¹ (x_i − x_k),    s_i = Σ_{k: d²_ik < γ} c_k exp(−d²_ik/2)

    A detection starts a track where none of its neighbourhood, d² < γ, has a larger s: at the peaks
    of the detections' density. Of equal ones the first by place is taken, in x and then in y. No
    two that start are in each other's neighbourhood.

    Args:
        started: [N, …] of a new track at each detection, positions first, in m.
        weight: [N] c of the detections.
        mask: [N] which may start one.
        limit: γ.

    Raises:
        ValueError: shapes do not fit.

    Example:
        >>> at = jnp.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [9.0, 0.0]])
        >>> started = Moments(at, jnp.stack([jnp.eye(2)] * 4))
        >>> print(one_a_neighbourhood(started, jnp.ones(4), jnp.ones(4, bool)))
        [False  True False  True]
    """
    check_array("started.mean", started.mean, shape=("N", "S"))
    number, size = started.mean.shape
    check_array("started.covariance", started.covariance, shape=(number, size, size))
    check_array("weight", weight, shape=(number,))
    check_array("mask", mask, shape=(number,))
    place, spread = started.mean[:, :2], started.covariance[:, :2, :2]
    here = Predicted(place, spread, jnp.zeros((2, 2), place.dtype), mask)
    there = Scan(jnp.zeros((), place.dtype), jnp.asarray(True), place, mask, spread)
    found = gate(here, there, limit)
    near = jnp.where(found.inside, found.squared_distance, 0.0)
    counted = jnp.where(mask, weight, 0.0)[None, :]
    support = jnp.where(found.inside, counted * jnp.exp(-near / 2), 0.0).sum(1)

    x, y = (jnp.where(mask, place[:, k], 0.0) for k in (0, 1))
    order = jnp.arange(number, dtype=jnp.int32)
    ahead = order[None, :] < order[:, None]
    for key in (y, x, -support):  # the last one decides first
        ahead = (key[None, :] < key[:, None]) | ((key[None, :] == key[:, None]) & ahead)
    return mask & ~(found.inside & ahead).any(1)
