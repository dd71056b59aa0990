"""What became of two tracks after their targets met: kept apart, exchanged, or lost."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array, check_known, check_size
from jaxtrack.numerics.masked import masked_mean
from jaxtrack.numerics.safe import safe_norm
from jaxtrack.types import Array


class SwapLoss(NamedTuple):
    """The verdict on one run, and the distances that it rests on."""

    swap: Array  # [] each track follows the other's target
    loss: Array  # [] not exchanged, and a track is away from its own target
    own_m: Array  # [2] mean distance of each track from its own target, where it is, last looks
    crossed_m: Array  # [2] and from the other's


def swap_and_loss(
    estimates_m: Array,
    truths_m: Array,
    estimates_mask: Array | None = None,
    *,
    limit_m: Any = 3.0,
    looks: int = 3,
) -> SwapLoss:
    """Judge two tracks by the last looks of a run.

        swap: Σ_i ‖x_i − y_{3−i}‖ < Σ_i ‖x_i − y_i‖ and both ‖x_i − y_{3−i}‖ < limit
        loss: no swap, and ‖x_i − y_i‖ ≥ limit for one of them or both

    Distances are means over the last looks.

    Args:
        estimates_m: [T, 2, D] positions of the tracks.
        truths_m: [T, 2, D] positions of the targets that they started on.
        estimates_mask: [T, 2] where the tracks still are; None: everywhere. One that is gone in
            one of the last looks is lost.
        limit_m: from where on a track has lost its target.
        looks: how many looks count, static.

    Raises:
        ValueError: shapes do not fit, or there are fewer looks.
        TypeError: not real numbers.

    Example:
        >>> truths = jnp.array([[[0.0, 0.0], [8.0, 0.0]]] * 3)
        >>> verdict = swap_and_loss(truths[:, ::-1] + 0.5, truths)
        >>> print(verdict.swap, verdict.loss)
        True False

    Source: the readings of the clustering cloud-like model (2019), whose words on lost and confused
        tracks of its figures 12 to 15 they make a rule of.
    """
    check_array("estimates_m", estimates_m, shape=("T", 2, "D"))
    check_array("truths_m", truths_m, shape=jnp.shape(estimates_m))
    check_array("limit_m", limit_m, shape=())
    check_known("limit_m", limit_m, lambda value: value > 0, "a positive number")
    check_size("looks", looks)
    if jnp.shape(truths_m)[0] < looks:
        raise ValueError(f"estimates_m: got {jnp.shape(truths_m)[0]} looks, want at least {looks}")
    found, true = jnp.asarray(estimates_m)[-looks:], jnp.asarray(truths_m)[-looks:]
    there = jnp.ones(found.shape[:2], bool)
    if estimates_mask is not None:
        check_array("estimates_mask", estimates_mask, shape=jnp.shape(estimates_m)[:2])
        there = jnp.asarray(estimates_mask, bool)[-looks:]
    found = jnp.where(there[..., None], found, 0.0)
    mean = lambda apart: masked_mean(safe_norm(apart), there, axis=0)
    own, crossed = mean(found - true), mean(found - true[:, ::-1])
    limit = jnp.asarray(limit_m, own.dtype)
    kept = there.all()
    swap = kept & (crossed.sum() < own.sum()) & (crossed < limit).all()
    loss = ~swap & ~(kept & (own < limit).all())
    return SwapLoss(swap, loss, own, crossed)
