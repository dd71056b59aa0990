"""Are reported tracks as sure of themselves as they may be? NEES of the tracks that are a target's.

Which track is whose is decided over its whole life, and a target has one at a time: a false track
that passes a target, or starts beside its track, is none of it; a track that has lost its target
counts, with all that it is off, as long as it was the target's most of the time.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.metrics import nees
from jaxtrack.types import Array, Truth

NEAR_M = 20.0
"""A report farther from every target is none's."""


class Found(NamedTuple):
    """What a tracker reports."""

    mean: Array  # [T, M, 4]
    covariance: Array  # [T, M, 4, 4]
    mask: Array  # [T, M]
    identity: Array  # [T, M]


class Consistency(NamedTuple):
    """Look by look, of one tracker."""

    nees: Array  # [T] sum over the reports that are of a target's tracks
    own: Array  # [T] how many these are
    strays: Array  # [T] how many others


def consistency_of(found: Found, truth: Truth) -> Consistency:
    """Return the summed NEES of reports of targets' tracks, their number and that of the others.

    Example:
        >>> truth = Truth(jnp.arange(3.0), jnp.zeros((3, 1, 4)), jnp.ones((3, 1), bool))
        >>> mean = jnp.zeros((3, 2, 4)).at[2, 0].set(1.0).at[:2, 1, 0].set(90.0)
        >>> found = Found(mean, jnp.ones((3, 2, 1, 1)) * jnp.eye(4), jnp.ones((3, 2), bool),
        ...               jnp.array([[0, 1]] * 3))
        >>> print(*consistency_of(found, truth))
        [0. 0. 4.] [1 1 1] [1 1 1]
    """
    owner = owners(found, truth)
    slots = jnp.maximum(owner, 0)
    there = jnp.take_along_axis(truth.mask, slots, axis=1)
    own = (owner >= 0) & there & found.mask
    unit = jnp.eye(4, dtype=found.mean.dtype)
    spread = jnp.where(own[..., None, None], found.covariance, unit[None, None])
    state = jnp.take_along_axis(truth.state, slots[..., None], axis=1)
    each = jax.vmap(jax.vmap(lambda *x: nees(*x).squared))
    squared = jnp.where(own, each(found.mean, spread, state), 0.0)
    count = lambda mask: mask.sum(1, dtype=jnp.int32)
    return Consistency(squared.sum(1), count(own), count(found.mask & ~own))


def owners(found: Found, truth: Truth) -> Array:
    """Return the target of each report's track, [T, M] int; −1: no target's most of its life.

    A report is near the closest target within `NEAR_M`, and a track is the target's that more than
    half of its reports are near; of several at a look the one that is near it the most often.

    Example:
        >>> truth = Truth(jnp.arange(3.0), jnp.zeros((3, 1, 4)), jnp.ones((3, 1), bool))
        >>> mean = jnp.zeros((3, 1, 4)).at[0, 0, 0].set(50.0)
        >>> found = Found(mean, jnp.ones((3, 1, 4, 4)), jnp.ones((3, 1), bool),
        ...               jnp.zeros((3, 1), int))
        >>> print(owners(found, truth)[:, 0])
        [0 0 0]
    """
    dtype = found.mean.dtype
    gap = ((found.mean[:, :, None, :2] - truth.state[:, None, :, :2]) ** 2).sum(-1)
    gap = jnp.where(truth.mask[:, None], gap, jnp.inf)
    every = jnp.arange(truth.mask.shape[1])
    closest = every[None, None] == gap.argmin(2)[..., None]
    near = (closest & (gap < NEAR_M**2) & found.mask[..., None]).astype(dtype)

    def slot(of: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        near, mask, identity = of
        same = (identity[:, None] == identity[None, :]) & mask[:, None] & mask[None, :]
        times = same.astype(dtype) @ near
        whose = times.argmax(1).astype(jnp.int32)
        most = 2 * times.max(1) > same.sum(1, dtype=dtype)
        return jnp.where(most, whose, -1), times.max(1)

    columns = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), (near, found.mask, found.identity))
    owner, times = (x.T for x in jax.lax.map(slot, columns))
    slots = jnp.arange(owner.shape[1])
    rival = (owner[:, :, None] == owner[:, None, :]) & found.mask[:, None, :]
    more, equal = (f(times[:, None, :], times[:, :, None]) for f in (jnp.greater, jnp.equal))
    ahead = more | (equal & (slots[None, None, :] < slots[None, :, None]))
    return jnp.where((rival & ahead).any(2), -1, owner)
