"""The Rauch–Tung–Striebel smoother: what the later looks say about the earlier states."""

import jax
import jax.numpy as jnp

from jaxtrack.filtering.gaussian import Moments, symmetric
from jaxtrack.numerics.checks import check_array
from jaxtrack.numerics.definite import rounding_floor, scaled_root
from jaxtrack.types import Array


def smooth(filtered: Moments, predicted: Moments, transitions: Array, noises: Array) -> Moments:
    """Return the states given all looks.

        G = P Fᵀ (P⁻)⁻¹,   mˢ = m + G (mˢ₊ − m⁻),
        Pˢ = (I − G F) P (I − G F)ᵀ + G (Pˢ₊ + Q) Gᵀ

    with P at a look, and F, Q, m⁻, P⁻, mˢ₊ and Pˢ₊ of the next one.

    Args:
        filtered: mean [T, S] and covariance [T, S, S] at each look.
        predicted: the same before each look.
        transitions: [T, S, S] F, from the look before to each; the first is not used.
        noises: [T, S, S] Q, the same way.

    Returns:
        mean [T, S] and covariance [T, S, S]; the last is the filtered one. The `FilterInfo` of any
        filter of this package fits: `smooth(info.filtered, info.predicted, info.transition,
        info.noise)` is the extended smoother after `extended`, the unscented one after `unscented`.

    Raises:
        ValueError: shapes do not fit together.

    Example:
        Seen at 0 and 2 s, a point that stands is in between where it must be:

        >>> states = Moments(jnp.array([[0.0], [0.0], [1.0]]), jnp.array([[[1.0]], [[2.0]], [[1.5]]]))
        >>> before = Moments(jnp.zeros((3, 1)), jnp.array([[[1.0]], [[2.0]], [[3.0]]]))
        >>> after = smooth(states, before, jnp.ones((3, 1, 1)), jnp.ones((3, 1, 1)))
        >>> print((3 * after.mean).ravel().round())
        [1. 2. 3.]

    Source: H. Rauch, F. Tung and C. Striebel, Maximum likelihood estimates of linear dynamic
    systems, AIAA Journal 3 (1965).

    Note:
        The covariance is usually written P + G (Pˢ₊ − P⁻) Gᵀ, a difference that in float32 need
        not be positive; the sum of squares above is equal to it, and is.
    """  # noqa: E501
    check_array("filtered.mean", filtered.mean, shape=("T", "S"))
    looks, size = jnp.shape(filtered.mean)
    check_array("predicted.mean", predicted.mean, shape=(looks, size))
    for name, array in (
        ("filtered.covariance", filtered.covariance),
        ("predicted.covariance", predicted.covariance),
        ("transitions", transitions),
        ("noises", noises),
    ):
        check_array(name, array, shape=(looks, size, size))
    unit = jnp.eye(size, dtype=filtered.mean.dtype)

    def back(later: Moments, one: tuple[Moments, Moments, Array, Array]) -> tuple[Moments, Moments]:
        here, ahead, transition, noise = one
        root, _ = scaled_root(ahead.covariance, floor=rounding_floor(ahead.covariance))
        gain = here.covariance @ transition.T @ root.T @ root
        kept = unit - gain @ transition
        spread = gain @ (later.covariance + noise) @ gain.T
        smoothed = Moments(
            here.mean + gain @ (later.mean - ahead.mean),
            symmetric(kept @ here.covariance @ kept.T + spread),
        )
        return smoothed, smoothed

    last = jax.tree.map(lambda x: x[-1], filtered)
    early = jax.tree.map(lambda x: x[:-1], filtered)
    ahead, transitions, noises = jax.tree.map(lambda x: x[1:], (predicted, transitions, noises))
    _, smoothed = jax.lax.scan(back, last, (early, ahead, transitions, noises), reverse=True)
    return jax.tree.map(lambda x, end: jnp.concatenate([x, end[None]]), smoothed, last)
