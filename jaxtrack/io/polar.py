"""Range and bearing, as a sensor gives them, to positions in the axes the bearing belongs to.

A bearing turns from the first axis towards the second, whatever the axes are, so the two
conventions share one formula; they differ in what the result's axes are, and in how the axes lie
on a map:

    ====================  =========================  =====================  ============
    bearing               zero and sense             x, y of the result     axes
    ====================  =========================  =====================  ============
    clockwise_from_north  north, clockwise           x north, y east        north_east
    math                  x axis, counter-clockwise  the user's own x and   x_y
                                                     y, y left of x
    ====================  =========================  =====================  ============

Own ship is in the same axes: under `clockwise_from_north` its position is (north, east), in that
order, and its heading turns clockwise from north. A bearing is relative to the heading; with a
heading of zero it is relative to the x axis: a true bearing.
"""

from typing import Any

import numpy as np

from jaxtrack.numerics.checks import check_choice

AXES_OF_BEARING = {"clockwise_from_north": "north_east", "math": "x_y"}


def position_from_polar(
    range_m: Any,
    bearing_rad: Any,
    *,
    bearing: str = "clockwise_from_north",
    own_position_m: Any = 0.0,
    own_heading_rad: Any = 0.0,
) -> np.ndarray:
    """Return where a range and a bearing from own ship point to.

    x = x₀ + r cos(b + ψ), y = y₀ + r sin(b + ψ), in NumPy float64.

    Args:
        range_m: r, metres, [...].
        bearing_rad: b, radians, relative to the heading ψ, [...].
        bearing: `"clockwise_from_north"`: the result is (north, east); `"math"`: (x, y), see the
            module's table.
        own_position_m: (x₀, y₀) in the result's axes, [..., 2] or a number for both.
        own_heading_rad: ψ, in the bearing's sense, [...].

    Returns:
        Positions, metres, [..., 2]. For `clockwise_from_north` hand them on with
        `axes="north_east"`.

    Raises:
        ValueError: `bearing` is neither of the two words.

    Example:
        A target 100 m due east, first by compass, then in a map's axes (x east, y north):

        >>> position_from_polar(100.0, np.pi / 2).round(3).tolist()
        [0.0, 100.0]
        >>> position_from_polar(100.0, 0.0, bearing="math").round(3).tolist()
        [100.0, 0.0]
    """
    check_choice("bearing", bearing, tuple(AXES_OF_BEARING))
    angle_rad = np.asarray(bearing_rad, np.float64) + np.asarray(own_heading_rad, np.float64)
    unit = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)
    offset_m = np.asarray(range_m, np.float64)[..., None] * unit
    return np.asarray(own_position_m, np.float64) + offset_m


def covariance_from_polar(
    range_m: Any,
    bearing_rad: Any,
    sigma_range_m: Any,
    sigma_bearing_rad: Any,
    *,
    own_heading_rad: Any = 0.0,
) -> np.ndarray:
    """Return the covariance of `position_from_polar` to first order in the errors.

    R = σ_r² u uᵀ + (r σ_b)² n nᵀ, with u = (cos(b + ψ), sin(b + ψ)) and n at right angles to it.

    Args:
        range_m: r, metres, [...].
        bearing_rad: b, radians, relative to the heading, [...].
        sigma_range_m: σ_r, metres, [...].
        sigma_bearing_rad: σ_b, radians, [...].
        own_heading_rad: ψ, [...]; taken as free of error.

    Returns:
        Covariances, square metres, [..., 2, 2]; singular at range zero.

    Example:
        >>> covariance_from_polar(100.0, 0.0, 2.0, 0.01).tolist()
        [[4.0, 0.0], [0.0, 1.0]]
    """
    angle_rad = np.asarray(bearing_rad, np.float64) + np.asarray(own_heading_rad, np.float64)
    along = np.asarray(sigma_range_m, np.float64)
    across = np.asarray(range_m, np.float64) * np.asarray(sigma_bearing_rad, np.float64)
    unit = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1) * along[..., None]
    normal = np.stack([-np.sin(angle_rad), np.cos(angle_rad)], axis=-1) * across[..., None]
    return unit[..., :, None] * unit[..., None, :] + normal[..., :, None] * normal[..., None, :]
