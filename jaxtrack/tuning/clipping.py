"""A loss whose gradient is bounded in every single realization."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax

from jaxtrack.numerics.bijectors import Bijector, bijector_of, identity
from jaxtrack.numerics.checks import check_array, check_known
from jaxtrack.types import Array, Key


def clip_each(
    loss: Callable[[Any, Key], Array], most: float, bijectors: Any = None
) -> Callable[[Any, Key], Array]:
    """Return the loss, with a gradient that no realization dominates.

        ∇_u L ← ∇_u L · min(1, c / |∇_u L|),   params = g(u)

    Gradients through many looks are heavy-tailed, so the mean points where a few realizations do.
    Clipped one by one most of them count alike, as in a median, and the mean's error is small.
    `fit`'s own `clip` bounds the mean, after the harm is done.

    Args:
        loss: as `fit` takes it.
        most: c, largest norm of one realization's gradient in the free parameters.
        bijectors: g, as `fit` takes them.

    Returns:
        A new function: define it once, as every loss.

    Raises:
        TypeError: `loss` is no function, or `most` no number.
        ValueError: `most` is not positive.

    Example:
        >>> from jaxtrack.tuning import clip_each
        >>> wild = lambda x, key: x * 100.0
        >>> print(jax.grad(clip_each(wild, 0.5))(1.0, jax.random.key(0)))
        0.5

    Source: M. Abadi and others, "Deep Learning with Differential Privacy", 2016, algorithm 1,
        without the noise.

    Note:
        The mean is biased: where few realizations say rightly what is wrong, it may lead past the
        least loss. Watch what is held out.
        What is not finite stays so, for `fit` to leave the step out. In reverse mode only.
    """
    if not callable(loss):
        raise TypeError(f"loss: got {type(loss).__name__}, want a function of params, key")
    check_array("most", most, shape=())
    check_known("most", most, lambda c: c > 0, "a positive number")
    bijector = bijector_of(identity() if bijectors is None else bijectors)

    def clipped(params: Any, key: Key) -> Array:
        return loss(_bounded(bijector, most, params), key)

    return clipped


def length(tree: Any) -> Array:
    """Return the norm of a pytree's leaves together, also where their squares overflow.

    Example:
        >>> print(length({"a": jnp.float32(3e30), "b": jnp.float32(4e30)}))
        5e+30
    """
    largest = jnp.stack([abs(x).max(initial=0) for x in jax.tree.leaves(tree)]).max()
    unit = jnp.where(jnp.isfinite(largest) & (largest > 0), largest, 1)
    return unit * optax.tree.norm(jax.tree.map(lambda x: x / unit.astype(x.dtype), tree))


def shortened(tree: Any, norm: Array, most: float) -> Any:
    """Return a pytree of a norm, scaled down to another one where that is less.

    Example:
        >>> print(shortened({"a": 4.0 * jnp.ones(1)}, 4.0, 1.0)["a"])
        [1.]
    """
    scale = jnp.where(norm > most, most / jnp.where(norm > most, norm, 1), 1)
    return jax.tree.map(lambda x: x * scale.astype(x.dtype), tree)


def _passed(bijector: Bijector, most: float, params: Any) -> tuple[Any, Any]:
    return params, params


def _back(bijector: Bijector, most: float, params: Any, gradient: Any) -> tuple[Any]:
    _, back = jax.vjp(bijector.forward, bijector.inverse(params))
    return (shortened(gradient, length(back(gradient)), most),)


def _identity(bijector: Bijector, most: float, params: Any) -> Any:
    return params


_bounded = jax.custom_vjp(_identity, nondiff_argnums=(0, 1))
_bounded.defvjp(_passed, _back)
