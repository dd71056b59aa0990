"""What an update with a look does to moments, in the space of the measurement; H = [I 0]."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.association.gating import Association, Predicted
from jaxtrack.numerics.safe import safe_divide
from jaxtrack.types import Array, Scan

LEAST = 1e-12  # echoes; fewer are none


class Step(NamedTuple):
    """What an update does, in the space of the measurement; entries [T], matrices xx, xy, yy."""

    moved: tuple[Array, ...]  # x⁺ = x + P Hᵀ moved
    inverse: tuple[Array, ...]  # mean S⁻¹ given a detection
    middle: tuple[Array, ...]  # W
    total: Array  # probability of a detection
    miss: Array


def move(mean: Array, covariance: Array, there: Array, step: Step) -> tuple[Array, Array]:
    """Return x + B y and β₀ P + b (I − K H) P (I − K H)ᵀ + B W Bᵀ with B = P Hᵀ, K = B S⁻¹."""
    before = jnp.where(there[:, None], mean, 0.0)
    p = jnp.where(there[:, None, None], covariance, 0.0)
    bx, by = p[:, :, 0], p[:, :, 1]
    ixx, ixy, iyy = (one[:, None] for one in step.inverse)
    kx, ky = bx * ixx + by * ixy, bx * ixy + by * iyy
    left = p - _outer(kx, bx) - _outer(ky, by)
    # Its first two columns, told apart: the compiler computes what it fuses anew for each entry.
    first, second = (
        one - kx * bx[:, k, None] - ky * by[:, k, None] for k, one in enumerate((bx, by))
    )
    both = left - _outer(first, kx) - _outer(second, ky)
    wxx, wxy, wyy = (one[:, None] for one in step.middle)
    through = _outer(bx * wxx + by * wxy, bx) + _outer(bx * wxy + by * wyy, by)
    after = step.miss[:, None, None] * p + step.total[:, None, None] * both + through
    moved = before + step.moved[0][:, None] * bx + step.moved[1][:, None] * by
    return jnp.where(there[:, None], moved, mean), jnp.where(
        there[:, None, None], after, covariance
    )


def quotient(numerator: Array, total: Array) -> Array:
    """Return numerator / total, 0 where the total is nothing; finite gradients for any total."""
    return safe_divide(numerator, jnp.where(total > LEAST, total, 0.0))


def sandwich(a: tuple[Array, ...], m: tuple[Array, ...] | list[Array]) -> tuple[Array, ...]:
    """Return A M A for symmetric matrices given as xx, xy, yy."""
    axx, axy, ayy = a
    mxx, mxy, myy = m
    first, second = axx * mxx + axy * mxy, axx * mxy + axy * myy
    third, fourth = axy * mxx + ayy * mxy, axy * mxy + ayy * myy
    return first * axx + second * axy, first * axy + second * ayy, third * axy + fourth * ayy


def _outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None, :]


def weighted_outer(weight: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return Σ_i w_i (x_i, y_i)(x_i, y_i)ᵀ over the last axis: xx, xy, yy."""
    return (weight * x * x).sum(-1), (weight * x * y).sum(-1), (weight * y * y).sum(-1)


def if_any(
    update: Callable[..., tuple[Array, Array]],
    there: Array,
    mean: Array,
    covariance: Array,
    *more: Predicted | Scan | Association,
) -> tuple[Array, Array]:
    """Return moments updated, or as they are where no slot holds a track.

    A branch is a unit to the compiler, and what leads back out of it stands in memory once. Without
    one each gradient that needs it computes it anew, and all of them take three times as long. What
    is inside is computed again on the way back: to bring all of it out of the branch takes longer.
    """
    at = there, mean, covariance, *more
    like = jax.eval_shape(update, *at)
    stay = lambda there, *moments: tuple(
        jnp.asarray(x, y.dtype) for x, y in zip(moments[:2], like, strict=True)
    )
    return jax.lax.cond(there.any(), jax.checkpoint(update, prevent_cse=False), stay, *at)
