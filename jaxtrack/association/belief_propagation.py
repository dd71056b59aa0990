"""Marginal association probabilities by loopy belief propagation, for many tracks.

    μ_ij = w_ij / (w_0j + Σ_{k≠i} w_kj ν_kj),    ν_ij = 1 / (1 + Σ_{k≠j} μ_ik),
    p_ij ≈ w_ij ν_ij / (w_0j + Σ_k w_kj ν_kj)

for detections i and tracks j, in O(M T) an iteration. The messages always converge. What they
converge to is exact where no two tracks share more than one detection and these links close no
loop (a track alone, separate gates), and overconfident elsewhere.
"""

import functools

import jax
import jax.numpy as jnp

from jaxtrack.association import pda
from jaxtrack.association.gating import (
    Association,
    AssociationParams,
    Predicted,
)
from jaxtrack.association.ratios import likelihood_ratios
from jaxtrack.numerics.checks import check_array, check_size
from jaxtrack.numerics.segments import costly
from jaxtrack.types import Array, Key, Scan

_FEW = 32  # terms
_LARGE = 1e15


def marginals(likelihood_ratio: Array, miss: Array, *, iterations: int = 30) -> Array:
    """Return about the probability of each detection, and last of the miss: [T, M + 1].

    Args:
        likelihood_ratio: [T, M] w ≥ 0; zero for pairs that may not be.
        miss: [T] w_0, at least 1e-12 counts.
        iterations: so many. Static.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers, or `iterations` is not an int.

    Example:
        >>> ratio = jnp.array([[8.0, 0.0], [8.0, 1.0]])
        >>> print((100 * marginals(ratio, jnp.ones(2))).round())
        [[62.  0. 38.]
         [31. 35. 35.]]

    Source: J. Williams and R. Lau, "Approximate evaluation of marginal association probabilities
        with belief propagation", 2014.
    """
    return _propagate(likelihood_ratio, miss, iterations)[0]


def associate(
    predicted: Predicted,
    scan: Scan,
    params: AssociationParams,
    key: Key | None = None,
    *,
    iterations: int = 30,
) -> Association:
    """Associate all tracks jointly, approximately.

    Args:
        predicted: T tracks, any number.
        scan: one look of M detections.
        params: detection probability, clutter density and gate.
        key: not used.
        iterations: so many. Static.

    Returns:
        The association; it counts as converged where the last iteration moved no probability by
        more than 1e-3.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers, or `iterations` is not an int.

    Example:
        >>> predicted = Predicted(jnp.array([[0.0, 0.0], [3.0, 0.0]]), jnp.stack([jnp.eye(2)] * 2),
        ...                       jnp.eye(2), jnp.ones(2, bool))
        >>> places = jnp.array([[1.0, 0.0], [2.0, 0.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(2, bool))
        >>> print(associate(predicted, scan, AssociationParams(0.9, 1e-3)).converged)
        True
    """
    ratio, miss = likelihood_ratios(predicted, scan, params)

    # Where no two tracks share a detection no message says anything.
    shared = ((ratio > 0).sum(0) > 1).any()

    def alone(ratio: Array, miss: Array) -> tuple[Array, Array]:
        return pda.marginals(*_scaled(ratio, miss)), jnp.zeros((), ratio.dtype)

    # A branch, for what leads back out of one stands in memory: see `step.if_any`.
    propagate = functools.partial(_propagate, iterations=iterations)
    branches = (jax.checkpoint(f, prevent_cse=False) for f in (propagate, alone))
    found, moved = jax.lax.cond(shared, *branches, ratio, miss)
    found = costly(found)
    return Association(found[:, :-1], found[:, -1], moved < 1e-3)


def _propagate(weight: Array, miss: Array, iterations: int) -> tuple[Array, Array]:
    """Return the probabilities, and how far the last iteration moved any of them."""
    check_array("likelihood_ratio", weight, shape=("T", "M"))
    check_array("miss", miss, shape=(weight.shape[0],))
    check_size("iterations", iterations)
    weight, missed = _scaled(weight, miss)
    before, after = _messages(weight, missed, iterations)
    found, last = (pda.marginals(weight * nu, missed) for nu in (after, before))
    moved = jnp.abs(jax.lax.stop_gradient(found - last)).max(initial=0.0)
    return found, moved


def _scaled(weight: Array, miss: Array) -> tuple[Array, Array]:
    # A row's scale is no matter, but of the largest numbers sums are none, nor reciprocals.
    weight = jnp.minimum(weight, jnp.finfo(jnp.result_type(weight, float)).max / 1024)
    largest = jax.lax.stop_gradient(weight).max(1, initial=0.0)
    scale = jnp.where(largest > _LARGE, largest, 1.0)
    return weight / scale[:, None], pda.floored(miss / scale)


def _messages(weight: Array, missed: Array, iterations: int) -> tuple[Array, Array]:
    """Return the messages ν before and after the last iteration."""
    go = lambda nu, _: (_iterate(nu, weight, missed), None)
    before, _ = jax.lax.scan(go, jnp.ones_like(weight), length=iterations - 1)
    return before, _iterate(before, weight, missed)


def _iterate(nu: Array, weight: Array, missed: Array) -> Array:
    mu = weight / (missed[:, None] + _sum_of_others(weight * nu, 1))
    return 1 / (1 + _sum_of_others(mu, 0))


def _sum_of_others(x: Array, axis: int) -> Array:
    """Return at each place the sum over all other places along the axis.

    The total minus the own term has no digits left where that dominates. Of few terms every sum is
    made by itself, which is five times as fast; of many they are sums from both ends.
    """
    size = x.shape[axis]
    if size <= _FEW:
        others = 1 - jnp.eye(size, dtype=x.dtype)
        if axis == 1:
            return (x[:, :, None] * others[None]).sum(1)
        return (others[:, :, None] * x[None]).sum(1)
    last = size - 1
    nothing = jnp.zeros_like(jax.lax.slice_in_dim(x, 0, 1, axis=axis))

    def before(x: Array) -> Array:
        ahead = jax.lax.slice_in_dim(x, 0, last, axis=axis)
        return jnp.concatenate([nothing, jnp.cumsum(ahead, axis=axis)], axis=axis)

    return before(x) + jnp.flip(before(jnp.flip(x, axis)), axis)
