"""Scans over many looks whose gradients keep little in memory and decide nothing twice."""

import math
from collections.abc import Callable
from typing import TypeVar

import jax
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
        >>> import jax.numpy as jnp
        >>> print(decided(jnp.array([1, 0])))
        [1 0]
    """
    return checkpoint_name(x, _DECIDED)


def costly(x: Array) -> Array:
    """Return x as what is kept within a segment, "costly" to policies of `jax.checkpoint`.

    Example:
        >>> import jax.numpy as jnp
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
        >>> import jax.numpy as jnp
        >>> step = lambda total, x: (total + x, jnp.sin(total))
        >>> total, infos = scan_in_segments(step, 0.0, jnp.arange(6.0))
        >>> print(total, infos.shape)
        15.0 (6,)

    Note:
        A segment's length is the largest divisor of T up to √T. Of a prime T that is one look, and
        all states are kept: pad with looks that are not valid.
    """
    looks = jax.tree.leaves(xs)[0].shape[0]
    length = max((n for n in range(1, math.isqrt(looks) + 1) if looks % n == 0), default=1)
    policy = jax.checkpoint_policies.save_only_these_names
    # Inside a loop nothing can be merged across the checkpoint anyway, hence no barrier.
    one = jax.checkpoint(step, prevent_cse=False, policy=policy(_DECIDED, _COSTLY))

    def segment(state: CarryT, xs: XT) -> tuple[CarryT, YT]:
        return jax.lax.scan(one, state, xs)

    segment = jax.checkpoint(segment, prevent_cse=False, policy=policy(_DECIDED))
    xs = jax.tree.map(lambda x: x.reshape(looks // length, length, *x.shape[1:]), xs)
    last, infos = jax.lax.scan(segment, init, xs)
    return last, jax.tree.map(lambda y: y.reshape(looks, *y.shape[2:]), infos)
