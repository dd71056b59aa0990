"""What became of two tracks after their targets met: kept apart, exchanged, or lost."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxtrack.metrics.cutoff import check_known
from jaxtrack.numerics.checks import check_array, check_size
from jaxtrack.numerics.safe import safe_norm
from jaxtrack.types import Array


class SwapLoss(NamedTuple):
    """The verdict on one run, and the distances that it rests on."""

    swap: Array  # [] each track follows the other's target
    loss: Array  # [] not exchanged, and a track is away from its own target
    own_m: Array  # [2] mean distance of each track from its own target, in the last looks
    crossed_m: Array  # [2] and from the other's


def swap_and_loss(
    estimates_m: Array, truths_m: Array, *, limit_m: Any = 3.0, looks: int = 3
) -> SwapLoss:
    """Judge two tracks by the last looks of a run.

        swap: Σ_i ‖x_i − y_{3−i}‖ < Σ_i ‖x_i − y_i‖ and both ‖x_i − y_{3−i}‖ < limit
        loss: no swap, and ‖x_i − y_i‖ ≥ limit for one of them or both

    Distances are means over the last looks.

    Args:
        estimates_m: [T, 2, D] positions of the tracks; NaN where one is gone, which is a loss.
        truths_m: [T, 2, D] positions of the targets that they started on.
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
    own = safe_norm(found - true).mean(0)
    crossed = safe_norm(found - true[:, ::-1]).mean(0)
    limit = jnp.asarray(limit_m, own.dtype)
    swap = (crossed.sum() < own.sum()) & (crossed < limit).all()
    # Not "at least the limit": a distance that is not a number is a loss too.
    loss = ~swap & ~(own < limit).all()
    return SwapLoss(swap, loss, own, crossed)
