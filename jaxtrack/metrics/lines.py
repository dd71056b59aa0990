"""How far trajectories are from lines ρ = x cos θ + y sin θ, and which line fits them best."""

import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array
from jaxtrack.numerics.safe import safe_arctan2, safe_sqrt
from jaxtrack.types import Array, Lines


def line_distance(lines: Lines, position_m: Array) -> Array:
    """Compute the root mean square distance of every trajectory to every line.

        d²(m, k) = 1/T Σₜ (x_kt cos θ_m + y_kt sin θ_m − ρ_m)²

    Args:
        lines: M lines.
        position_m: [K, T, 2] trajectories, all of them finite.

    Returns:
        [M, K] distances in metres. Those of masked lines are finite and mean nothing.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> east_west = Lines(*jnp.asarray([[5.0], [0.0], [1.0]]), mask=jnp.ones(1, bool))
        >>> line_distance(east_west, jnp.asarray([[[5.0, 0.0], [5.0, 9.0]]])).tolist()
        [[0.0]]
    """
    check_array("lines.mask", lines.mask, shape=("M",))
    for name, value in zip(("rho_m", "theta_rad"), (lines.rho_m, lines.theta_rad), strict=True):
        check_array(f"lines.{name}", value, shape=jnp.shape(lines.mask))
    check_array("position_m", position_m, shape=("K", "T", 2))

    mask = jnp.asarray(lines.mask, bool)
    rho_m = jnp.where(mask, lines.rho_m, 0.0)[:, None, None]
    theta_rad = jnp.where(mask, lines.theta_rad, 0.0)[:, None, None]
    # Sums rather than a matrix product, which accelerators compute with few bits.
    x_m, y_m = position_m[None, :, :, 0], position_m[None, :, :, 1]
    offset_m = x_m * jnp.cos(theta_rad) + y_m * jnp.sin(theta_rad) - rho_m
    return safe_sqrt(jnp.mean(offset_m**2, axis=-1))


def least_squares_line(position_m: Array) -> tuple[Array, Array]:
    """Fit the line with the least sum of squared distances to the points (total least squares).

    Through the centroid x̄, ȳ with the normal across the scatter's main axis:

        θ = ½ atan2(2 S_xy, S_xx − S_yy) + π/2,   ρ = x̄ cos θ + ȳ sin θ

    Args:
        position_m: [T, 2] points. Without a main axis (all in one place) θ is π/2.

    Returns:
        ρ in metres and θ in [0, π) radians.

    Raises:
        ValueError: the shape does not fit.
        TypeError: not real numbers.

    Example:
        >>> rho_m, theta_rad = least_squares_line(jnp.asarray([[-1.0, 4.0], [7.0, 4.0]]))
        >>> round(float(rho_m), 3), round(float(theta_rad), 3)
        (4.0, 1.571)
    """
    check_array("position_m", position_m, shape=("T", 2))
    centre_m = jnp.mean(position_m, axis=0)
    x_m, y_m = (position_m - centre_m[None, :]).T
    course_rad = 0.5 * safe_arctan2(2.0 * jnp.sum(x_m * y_m), jnp.sum(x_m**2 - y_m**2))
    theta_rad = course_rad + jnp.pi / 2
    theta_rad = jnp.where(theta_rad < jnp.pi, theta_rad, theta_rad - jnp.pi)
    return centre_m[0] * jnp.cos(theta_rad) + centre_m[1] * jnp.sin(theta_rad), theta_rad
