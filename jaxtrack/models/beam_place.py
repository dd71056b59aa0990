"""Where a state is in a multi-beam sonar's frame: its range, and its bearing in beams."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.models.sonar import BeamSonar
from jaxtrack.numerics.safe import safe_divide, safe_sqrt
from jaxtrack.types import Array, BeamScan, Pose


class Place(NamedTuple):
    """Where states are in the sonar's frame, […]."""

    range_m: Array
    beams: Array  # from the port edge of the sector
    ahead_m: Array
    starboard_m: Array


def place_of(x: Array, y: Array, scan: BeamScan, sonar: BeamSonar) -> Place:
    """Return where earth positions are in the frame of a look's sonar."""
    pose = pose_of(scan)
    mount = jnp.asarray(sonar.mount_m, x.dtype)
    north, east = x - pose.position_m[0], y - pose.position_m[1]
    cos, sin = jnp.cos(pose.heading_rad), jnp.sin(pose.heading_rad)
    ahead = cos * north + sin * east - mount[0]
    starboard = cos * east - sin * north - mount[1]
    count = scan.mask.shape[0]
    beams = angle(starboard, ahead) * (count / jnp.asarray(sonar.sector_rad, x.dtype)) + count / 2
    return Place(safe_sqrt(ahead**2 + starboard**2), beams, ahead, starboard)


def pose_of(scan: BeamScan) -> Pose:
    """Where the carrier is; somewhere, in a look that never was."""
    return jax.tree.map(lambda x: jnp.where(scan.valid, x, jnp.zeros_like(x)), scan.pose)


def _arctangent_series(terms: int = 11) -> list[float]:
    """Coefficients c of arctan(t)/t ≈ Σ c_n t^2n on [0, 1], by Chebyshev interpolation."""
    squared = (1 - np.cos(np.pi * (np.arange(terms) + 0.5) / terms)) / 2
    root = np.sqrt(squared)
    fit = np.polynomial.Polynomial.fit(squared, np.arctan(root) / root, terms - 1, domain=[0, 1])
    return fit.convert().coef.tolist()


_SERIES = _arctangent_series()


def angle(y: Array, x: Array) -> Array:
    """Return the angle of (x, y) in [−π, π] to 1e-8 rad: on a CPU several times faster than atan2.

    Args:
        y: any shape.
        x: the same shape and unit. At the origin the angle is 0, with gradient 0.

    Example:
        >>> print(f"{angle(jnp.array(1.0), jnp.array(-1.0)):.5f}")
        2.35619
    """
    steep = jnp.abs(y) > jnp.abs(x)
    low, high = jnp.where(steep, x, y), jnp.where(steep, y, x)
    t = safe_divide(low, high)
    squared = t * t
    value = jnp.full_like(t, _SERIES[-1])
    for coefficient in _SERIES[-2::-1]:
        value = value * squared + coefficient
    value = value * t
    # (high, low) within 45° of an axis: which axis is known from the signs.
    back = jnp.where(y < 0, -math.pi, math.pi)
    flat = jnp.where(x < 0, value + back, value)
    return jnp.where(steep, jnp.where(y < 0, -math.pi / 2, math.pi / 2) - value, flat)
