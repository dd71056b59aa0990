"""Frames: sensor polar → body → earth, and back.

The earth frame has x to the north and y to the east, the body frame x ahead and y to starboard;
headings and bearings turn clockwise, from north and from ahead. Where the user's own x and y stand
for north and east, nothing changes.
"""

import jax.numpy as jnp

from jaxtrack.numerics.safe import safe_arctan2, safe_norm
from jaxtrack.types import Array, Pose


def polar_to_earth(
    range_m: Array, bearing_rad: Array, pose: Pose, mount_m: Array | tuple[float, float]
) -> Array:
    """Return the earth positions of what a sensor sees at ranges and bearings, [..., 2].

        η = S(ψ) (ρ [cos α, sin α]ᵀ + [x_S, y_S]ᵀ) + [n_V, e_V]ᵀ

    Args:
        range_m: [...] from the sensor.
        bearing_rad: [...] positive to starboard.
        pose: of the carrier, position_m [2] and heading_rad [].
        mount_m: [2] where the sensor sits in the body frame.

    Example:
        >>> pose = Pose(jnp.array([100.0, 50.0]), jnp.array(jnp.pi / 2))
        >>> print(polar_to_earth(jnp.array(10.0), jnp.array(0.0), pose, (2.0, 0.0)).round())
        [100.  62.]

    Source: clustering-statistic Hough transform (2018), equations 1–3.
    """
    mount = jnp.asarray(mount_m, range_m.dtype)
    ahead = range_m * jnp.cos(bearing_rad) + mount[0]
    starboard = range_m * jnp.sin(bearing_rad) + mount[1]
    cos, sin = jnp.cos(pose.heading_rad), jnp.sin(pose.heading_rad)
    north = cos * ahead - sin * starboard + pose.position_m[0]
    east = sin * ahead + cos * starboard + pose.position_m[1]
    return jnp.stack([north, east], axis=-1)


def earth_to_polar(
    position_m: Array, pose: Pose, mount_m: Array | tuple[float, float]
) -> tuple[Array, Array]:
    """Return range [...] and bearing [...] in (−π, π] of earth positions, seen from a sensor.

    Args:
        position_m: [..., 2] in the earth frame.
        pose: of the carrier, position_m [2] and heading_rad [].
        mount_m: [2] where the sensor sits in the body frame.

    Example:
        >>> pose = Pose(jnp.array([100.0, 50.0]), jnp.array(jnp.pi / 2))
        >>> print(*(x.round(3) for x in earth_to_polar(jnp.array([90.0, 60.0]), pose, (0.0, 0.0))))
        14.142 0.785

    Source: clustering-statistic Hough transform (2018), equations 1–3, solved for ρ and α.
    """
    mount = jnp.asarray(mount_m, position_m.dtype)
    north = position_m[..., 0] - pose.position_m[0]
    east = position_m[..., 1] - pose.position_m[1]
    cos, sin = jnp.cos(pose.heading_rad), jnp.sin(pose.heading_rad)
    ahead = cos * north + sin * east - mount[0]
    starboard = cos * east - sin * north - mount[1]
    return safe_norm(jnp.stack([ahead, starboard], axis=-1)), safe_arctan2(starboard, ahead)
