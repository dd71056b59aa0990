"""Hard and soft choice with one meaning: the soft one tends to the hard one with the temperature.

`temperature=None` is the hard choice throughout. A hard step is locally constant, so its gradient
is zero; a hard maximum passes its gradient to the first of the largest.
"""

from typing import Protocol

import jax
import jax.numpy as jnp

from jaxtrack.types import Array


def step(x: Array, temperature: Array | None) -> Array:
    """Return 1 where x ≥ 0, else 0; or the sigmoid of x / temperature.

    Example:
        >>> print(step(jnp.array([-1.0, 2.0]), None), step(jnp.array([0.0]), 0.1))
        [0. 1.] [0.5]
    """
    if temperature is None:
        return (x >= 0).astype(x.dtype)
    return jax.nn.sigmoid(x / jnp.asarray(temperature, x.dtype))


def greater(x: Array, y: Array, temperature: Array | None) -> Array:
    """Return the larger of two arrays, or their mean weighted by softmax.

    Example:
        >>> x, y = jnp.array([1.0, 4.0]), jnp.array([3.0, 2.0])
        >>> print(greater(x, y, None), greater(x, y, 1e-3))
        [3. 4.] [3. 4.]
    """
    first = step(x - y, temperature)
    return first * x + (1 - first) * y


class Pick(Protocol):
    """Reads arrays at a choice that was made."""

    def __call__(self, x: Array, index: Array | None = None) -> Array:
        """Read x [P, E], or the rows x[index] of a table x [T, ...] by an index [P, E]."""
        ...


def choose(value: Array, mask: Array, temperature: Array | None) -> tuple[Pick, Array]:
    """Choose the largest of each row's masked values.

    Args:
        value: [P, E] values, ≥ 0.
        mask: [P, E] which of them stand for choice.
        temperature: None for the first of the largest; else softmax weights.

    Returns:
        `pick`, which reads arrays at the choice (zeros in a row without any), and what the choice
        leaves, [P, E]: 1 less the weight of each alternative.

    Example:
        >>> value = jnp.array([[1.0, 3.0, 2.0]])
        >>> pick, left = choose(value, jnp.ones((1, 3), bool), None)
        >>> print(pick(value), left)
        [3.] [[1. 0. 1.]]
    """
    fixed = jax.lax.stop_gradient(jnp.where(mask, value, -1.0))
    if temperature is None:
        # The first index of the maximum, by two plain reductions: faster than a variadic argmax.
        largest = fixed.max(axis=-1, keepdims=True)
        size = value.shape[-1]
        order = jnp.arange(size, dtype=jnp.int32)[None, :]
        chosen = jnp.where(fixed == largest, order, size - 1).min(axis=-1, keepdims=True)
        exists = largest[..., 0] >= 0

        def pick(x: Array, index: Array | None = None) -> Array:
            at = x if index is None else index
            at = jnp.take_along_axis(jnp.broadcast_to(at, value.shape), chosen, axis=-1)[..., 0]
            taken = at if index is None else x[at]
            there = exists.reshape(exists.shape + (1,) * (taken.ndim - exists.ndim))
            return jnp.where(there, taken, jnp.zeros((), taken.dtype))

        return pick, (order != chosen).astype(value.dtype)

    scaled = (value - fixed.max(axis=-1, keepdims=True)) / jnp.asarray(temperature, value.dtype)
    raw = jnp.where(mask, jnp.exp(jnp.where(mask, scaled, 0.0)), 0.0)
    total = raw.sum(axis=-1, keepdims=True)
    weight = raw / jnp.where(total > 0, total, 1.0)

    def blend(x: Array, index: Array | None = None) -> Array:
        values = x if index is None else x[jnp.broadcast_to(index, value.shape)]
        extra = (1,) * (values.ndim - value.ndim)
        kept = jnp.where(mask.reshape(mask.shape + extra), values, 0.0)
        return (weight.reshape(weight.shape + extra) * kept).sum(axis=value.ndim - 1)

    return blend, 1 - weight
