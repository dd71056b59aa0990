"""Scans over many looks whose gradients keep little in memory and decide nothing twice."""

import math
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name

from jaxtrack.types import Array

CarryT = TypeVar("CarryT")
XT = TypeVar("XT")
YT = TypeVar("YT")

_DECIDED, _COSTLY = "decided", "costly"


def decided(x: Array) -> Array:
    """Return x, small and without a gradient, as what a way back takes over from the way there.

    It has the name "decided" to policies of `jax.checkpoint`. What led to it, loops and counters,
    is then not computed again.

    Example:
        >>> print(decided(jnp.array([1, 0])))
        [1 0]
    """
    return checkpoint_name(x, _DECIDED)


def costly(x: Array) -> Array:
    """Return x as what is kept within a segment, "costly" to policies of `jax.checkpoint`.

    Example:
        >>> print(costly(jnp.array([0.5])))
        [0.5]
    """
    return checkpoint_name(x, _COSTLY)


def scan_in_segments(
    step: Callable[[CarryT, XT], tuple[CarryT, YT]], init: CarryT, xs: XT
) -> tuple[CarryT, YT]:
    """Return `jax.lax.scan(step, init, xs)`; its gradient keeps about 2 √T states instead of all.

    The looks stand in segments. Kept is the state before each segment, and of every look what was
    `decided`; on the way back a segment is gone through once more for its states, and each of its
    looks a second time for what is differentiated. That is one run more, in a fifth of the memory
    that all inner values take, and less.

    Args:
        step: (state, look) → (state, info), as of an `Estimator`.
        init: state before the first look.
        xs: looks, a tree of arrays [T, …].

    Returns:
        The last state, and the infos [T, …].

    Example:
        >>> step = lambda total, x: (total + x, jnp.sin(total))
        >>> total, infos = scan_in_segments(step, 0.0, jnp.arange(6.0))
        >>> print(total, infos.shape)
        15.0 (6,)

    Raises:
        ValueError: there is nothing in `xs`.

    Source: A. Griewank, "Achieving Logarithmic Growth of Temporal and Spatial Complexity in Reverse
        Automatic Differentiation", 1992, with two levels.
    """
    if not jax.tree.leaves(xs):
        raise ValueError("xs: got nothing, want a tree of arrays [T, …]")
    looks = jax.tree.leaves(xs)[0].shape[0]
    root = max(math.isqrt(looks), 1)
    divisor = max(n for n in range(1, root + 1) if looks % n == 0)
    # Looks that are left over cost a program of their own: rather shorter segments than some.
    length = divisor if 2 * divisor >= root else root
    whole = looks - looks % length
    policy = jax.checkpoint_policies.save_only_these_names
    # Inside a loop nothing can be merged across the checkpoint anyway, hence no barrier.
    one = jax.checkpoint(step, prevent_cse=False, policy=policy(_DECIDED, _COSTLY))

    def segment(state: CarryT, xs: XT) -> tuple[CarryT, YT]:
        return jax.lax.scan(one, state, xs)

    segment = jax.checkpoint(segment, prevent_cse=False, policy=policy(_DECIDED))
    split = lambda x: x[:whole].reshape(whole // length, length, *x.shape[1:])
    state, infos = jax.lax.scan(segment, init, jax.tree.map(split, xs))
    infos = jax.tree.map(lambda y: y.reshape(whole, *y.shape[2:]), infos)
    if whole == looks:
        return state, infos
    state, rest = segment(state, jax.tree.map(lambda x: x[whole:], xs))
    return state, jax.tree.map(lambda *parts: jnp.concatenate(parts), infos, rest)
