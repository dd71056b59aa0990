"""OSPA at every look of a run, of positions and of velocities."""

from typing import Any, NamedTuple

import jax

from jaxtrack.metrics.ospa import Ospa, ospa
from jaxtrack.numerics.checks import check_array
from jaxtrack.types import Tracks, Truth


class OspaOverTime(NamedTuple):
    """Two curves, each with its parts."""

    position: Ospa  # [T], metres
    velocity: Ospa  # [T], metres a second


def ospa_over_time(
    tracks: Tracks, truth: Truth, *, cutoff_m: Any, cutoff_m_s: Any, order: Any
) -> OspaOverTime:
    """Return OSPA between the tracks and the targets of every look.

    Args:
        tracks: of T looks, stacked; `mask` says which of them count.
        truth: of the same looks.
        cutoff_m: c of the positions.
        cutoff_m_s: c of the velocities.
        order: p ≥ 1.

    Raises:
        ValueError: shapes do not fit, or a known cut-off or order is out of range.
        TypeError: not real numbers.

    Example:
        >>> import jax.numpy as jnp
        >>> one = jnp.ones((3, 1), bool)
        >>> truth = Truth(jnp.arange(3.0), jnp.zeros((3, 1, 4)), one)
        >>> number = jnp.zeros((3, 1), jnp.int32)
        >>> tracks = Tracks(truth.time_s, jnp.ones((3, 1, 4)) * jnp.array([3.0, 4.0, 0.0, 1.0]),
        ...                 jnp.zeros((3, 1, 4, 4)), one, number, number, one * 1.0, one * 0.0)
        >>> scores = ospa_over_time(tracks, truth, cutoff_m=20.0, cutoff_m_s=20.0, order=2.0)
        >>> print(scores.position.distance, scores.velocity.distance)
        [5. 5. 5.] [1. 1. 1.]

    Source: clustering statistic Hough transform (2018), equations 42 to 46, as in its tables 8 to 13.
    """  # noqa: E501
    looks, targets = _check(tracks, truth)
    check_array("truth.mask", truth.mask, shape=(looks, targets))

    def curve(of: slice, cutoff: Any) -> Ospa:
        one = lambda *sets: ospa(*sets, cutoff=cutoff, order=order)
        return jax.vmap(one)(tracks.mean[..., of], tracks.mask, truth.state[..., of], truth.mask)

    return OspaOverTime(curve(slice(0, 2), cutoff_m), curve(slice(2, 4), cutoff_m_s))


def _check(tracks: Tracks, truth: Truth) -> tuple[int, int]:
    check_array("truth.state", truth.state, shape=("T", "K", 4))
    looks, targets = truth.state.shape[:2]
    check_array("tracks.mean", tracks.mean, shape=(looks, "M", "S"))
    check_array("tracks.mask", tracks.mask, shape=tracks.mean.shape[:2])
    if tracks.mean.shape[-1] < 4:
        raise ValueError(
            f"tracks.mean: got states of length {tracks.mean.shape[-1]}, want x, y, vx, vy, …"
        )
    return looks, targets
