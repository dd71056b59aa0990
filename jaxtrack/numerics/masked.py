"""Reductions over the entries whose mask is True.

What stands under a False mask may be NaN or infinite and changes neither value nor gradient.
Every reduction has a defined result for a mask that is False throughout. The mask has the rank
of `x` and broadcasts to it: for points `[N, 2]` and a mask `[N]` pass `mask[:, None]`.
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxtrack.numerics.safe import as_float, safe_divide, take_along
from jaxtrack.types import Array


def masked_sum(x: ArrayLike, mask: Array, axis: int = -1) -> Array:
    """Sum of the valid entries; 0 if there are none.

    Args:
        x: any shape.
        mask: booleans that broadcast to it.
        axis: the axis that is reduced.

    Example:
        >>> float(masked_sum(jnp.array([1.0, jnp.nan]), jnp.array([True, False])))
        1.0
    """
    return jnp.sum(jnp.where(mask, as_float(x), 0.0), axis=axis)


def masked_mean(x: ArrayLike, mask: Array, axis: int = -1) -> Array:
    """Mean of the valid entries; 0 if there are none.

    Args:
        x: any shape.
        mask: booleans that broadcast to it.
        axis: the axis that is reduced.

    Example:
        >>> float(masked_mean(jnp.array([1.0, 3.0, jnp.nan]), jnp.array([True, True, False])))
        2.0
    """
    x = as_float(x)
    count = jnp.sum(jnp.broadcast_to(mask, x.shape), axis=axis, dtype=x.dtype)
    return safe_divide(masked_sum(x, mask, axis), count)


def masked_argmin(x: ArrayLike, mask: Array, axis: int = -1) -> Array:
    """Index of the first minimal valid entry; 0 if there are none, so that it can be gathered.

    Args:
        x: any shape.
        mask: booleans that broadcast to it.
        axis: the axis that is reduced.

    Example:
        >>> int(masked_argmin(jnp.array([0.0, 2.0, 1.0]), jnp.array([False, True, True])))
        2
    """
    x = jax.lax.stop_gradient(as_float(x))
    # Valid infinities become the largest finite number, to stay ahead of the masked entries.
    largest = jnp.asarray(jnp.finfo(x.dtype).max, dtype=x.dtype)
    return jnp.argmin(jnp.where(mask, jnp.clip(x, -largest, largest), jnp.inf), axis=axis)


def masked_argmax(x: ArrayLike, mask: Array, axis: int = -1) -> Array:
    """Index of the first maximal valid entry; 0 if there are none, so that it can be gathered.

    Args:
        x: any shape.
        mask: booleans that broadcast to it.
        axis: the axis that is reduced.

    Example:
        >>> int(masked_argmax(jnp.array([9.0, 2.0, 1.0]), jnp.array([False, True, True])))
        1
    """
    return masked_argmin(-as_float(x), mask, axis)


def masked_min(x: ArrayLike, mask: Array, axis: int = -1, fallback: ArrayLike = 0.0) -> Array:
    """Minimum of the valid entries; `fallback` if there are none.

    The gradient goes to the first minimal valid entry alone, as in `safe_min`.

    Args:
        x: any shape.
        mask: booleans that broadcast to it.
        axis: the axis that is reduced.
        fallback: the value where nothing is valid.

    Example:
        >>> float(masked_min(jnp.array([0.0, 2.0, 1.0]), jnp.array([False, True, True])))
        1.0
    """
    return _take_valid(as_float(x), mask, masked_argmin(x, mask, axis), axis, fallback)


def masked_max(x: ArrayLike, mask: Array, axis: int = -1, fallback: ArrayLike = 0.0) -> Array:
    """Maximum of the valid entries; `fallback` if there are none.

    The gradient goes to the first maximal valid entry alone, as in `safe_max`.

    Args:
        x: any shape.
        mask: booleans that broadcast to it.
        axis: the axis that is reduced.
        fallback: the value where nothing is valid.

    Example:
        >>> float(masked_max(jnp.array([9.0, 2.0, 1.0]), jnp.array([False, True, True])))
        2.0
    """
    return _take_valid(as_float(x), mask, masked_argmax(x, mask, axis), axis, fallback)


def masked_logsumexp(x: ArrayLike, mask: Array, axis: int = -1) -> Array:
    """Logarithm of Σ exp x over the valid entries, without overflow.

    If nothing is valid, or all that is valid is −inf, the result is the dtype's lowest finite
    number and the gradient is 0.

    Args:
        x: any shape, log-weights; finite or −inf.
        mask: booleans that broadcast to it.
        axis: the axis that is reduced.

    Example:
        >>> float(masked_logsumexp(jnp.array([3.0, jnp.nan]), jnp.array([True, False])))
        3.0

    Note:
        −inf would be the limit for no entries, but its differences are NaN in whatever follows.
    """
    x = as_float(x)
    peak = jax.lax.stop_gradient(masked_max(x, mask, axis))
    peak = jnp.where(jnp.isneginf(peak), 0.0, peak)
    # The largest valid term is exp(0): the sum is at least 1, unless there is no finite term.
    shifted = jnp.where(mask, x, -jnp.inf) - jnp.expand_dims(peak, axis)
    total = jnp.sum(jnp.exp(shifted), axis=axis)
    none = total == 0
    value = peak + jnp.log(jnp.where(none, 1.0, total))
    return jnp.where(none, jnp.asarray(jnp.finfo(x.dtype).min, dtype=x.dtype), value)


def _take_valid(x: Array, mask: Array, index: Array, axis: int, fallback: ArrayLike) -> Array:
    """Take the entries at `index`, or `fallback` where no entry along the axis is valid."""
    some = jnp.any(jnp.broadcast_to(mask, x.shape), axis=axis)
    return jnp.where(some, take_along(x, index, axis), fallback)
