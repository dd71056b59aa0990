"""Range and bearing as a measurement: what a sensor at a pose expects to see of a state.

Bearings are relative to the carrier's heading and turn clockwise where x is north and y east; with
a heading of zero they are true bearings. The geometry is that of `frames.earth_to_polar`.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.models.frames import earth_to_polar
from jaxtrack.numerics.safe import wrap_angle
from jaxtrack.types import Array, Pose


class PolarScan(NamedTuple):
    """One look of a sensor that reports ranges and bearings."""

    time_s: Array  # []
    valid: Array  # []  False: no look at all
    range_m: Array  # [N]
    bearing_rad: Array  # [N] relative to the heading
    mask: Array  # [N]
    pose: Pose
    covariance: Array | None = None  # [N, 2, 2] in m² and rad²; None: the estimator's own sigmas


def range_bearing(
    state: Array, pose: Pose, mount_m: Array | tuple[float, float] = (0.0, 0.0)
) -> Array:
    """Return the range and the bearing in (−π, π] at which a state is seen, [2].

    Args:
        state: [S] that begins with x, y in the earth frame, metres.
        pose: of the carrier.
        mount_m: [2] where the sensor sits in the body frame.

    Example:
        >>> pose = Pose(jnp.array([100.0, 50.0]), jnp.array(0.0))
        >>> print(range_bearing(jnp.array([100.0, 60.0, 1.0, 1.0]), pose).round(1))
        [10.   1.6]
    """
    return jnp.stack(earth_to_polar(state[:2], pose, mount_m))


def range_bearing_residual(measured: Array, expected: Array) -> Array:
    """Return measured − expected, [..., 2], the difference of the bearings in [−π, π).

    Example:
        >>> print(range_bearing_residual(jnp.array([5.0, 3.1]), jnp.array([4.0, -3.1])).round(3))
        [ 1.    -0.083]
    """
    difference = measured - expected
    return jnp.stack([difference[..., 0], wrap_angle(difference[..., 1])], axis=-1)
