"""Targets that fade for a while: weights of their detections, or detections that are dropped.

Two functions with one meaning. `fade` is differentiable in when and how long; `drop` makes looks of
it as a sensor would report them, with fewer detections and no weights.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array, check_positive
from jaxtrack.types import Array, Key, Scan


class Fade(NamedTuple):
    """When targets are not seen. Traced."""

    middle_s: Array  # [K] of each target's gap
    length_s: Array  # [K] of it, at half depth; 0: none
    edge_s: Array | float = 0.25  # how long it takes to go and to come, over 4


def fade(scans: Scan, origin: Array, fades: Fade) -> Scan:
    """Return looks whose detections of targets weigh less while these fade.

        w = 1 − [s((t − m + l/2)/e) − s((t − m − l/2)/e)],   s(x) = 1 / (1 + exp(−x))

    Args:
        scans: T looks of N detections, without weights.
        origin: [T, N] the target of each detection; −1: none's, and these keep the weight 1.
        fades: of K targets; as `edge_s` vanishes, weights become 0 and 1.

    Raises:
        ValueError: shapes do not fit, the looks have weights, or a known edge is not positive.
        TypeError: not real numbers.

    Example:
        >>> scans = Scan(jnp.arange(5.0), jnp.ones(5, bool), jnp.zeros((5, 1, 2)), jnp.ones((5, 1), bool))
        >>> gap = Fade(jnp.array([2.0]), jnp.array([2.0]), edge_s=0.1)
        >>> print(fade(scans, jnp.zeros((5, 1), int), gap).weight[:, 0].round(2))
        [1.  0.5 0.  0.5 1. ]
    """  # noqa: E501
    check_array("scans.time_s", scans.time_s, shape=("T",))
    check_array("origin", origin, shape=jnp.shape(scans.mask))
    check_array("fades.middle_s", fades.middle_s, shape=("K",))
    check_array("fades.length_s", fades.length_s, shape=jnp.shape(fades.middle_s))
    if scans.weight is not None:
        raise ValueError("scans.weight: got weights, want None: a fade sets them")
    time_s = jnp.asarray(scans.time_s)
    edge = check_positive("fades.edge_s", fades.edge_s, time_s.dtype)
    middle, half = (jnp.asarray(x, time_s.dtype) for x in (fades.middle_s, fades.length_s))
    half = half / 2
    since = time_s[:, None] - middle[None, :]  # [T, K]
    level = lambda x: jax.nn.sigmoid(x / edge)
    target = 1.0 - (level(since + half[None, :]) - level(since - half[None, :]))
    own = jnp.take_along_axis(target, jnp.where(origin >= 0, origin, 0), axis=1)
    return scans._replace(weight=jnp.where(origin >= 0, own, 1.0))


def drop(key: Key, scans: Scan) -> Scan:
    """Return looks where a detection of weight w is there with probability w, and has no weight.

    Args:
        key: random key.
        scans: looks with weights, of any shape.

    Raises:
        ValueError: the looks have no weights.

    Example:
        >>> scans = Scan(jnp.array(0.0), jnp.array(True), jnp.zeros((3, 2)), jnp.ones(3, bool),
        ...              weight=jnp.array([1.0, 0.0, 1.0]))
        >>> print(drop(jax.random.key(0), scans).mask)
        [ True False  True]
    """
    if scans.weight is None:
        raise ValueError("scans.weight: got None, want the weights of the detections")
    weight = jnp.asarray(scans.weight)
    there = jax.random.uniform(key, weight.shape, weight.dtype) < weight
    return scans._replace(mask=scans.mask & there, weight=None)
