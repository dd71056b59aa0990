"""Straight lines in the plane, in the normal form of the Hough transform.

    ρ = x cos θ + y sin θ,   θ ∈ [0, π),   ρ signed.

A line has two names, (ρ, θ) and (−ρ, θ ± π); every difference here is taken between the two
nearest names. With θ confined to half a turn the sign of ρ is what tells the sides apart.
"""

import jax.numpy as jnp

from jaxtrack.numerics.safe import safe_arctan2, safe_divide, safe_norm
from jaxtrack.types import Array


def line_through(first_m: Array, second_m: Array, origin_m: Array) -> tuple[Array, Array]:
    """Return (ρ, θ) of the line through two points, ρ measured from `origin_m`.

        n = (−d_y, d_x) / |d|, turned so that θ ∈ [0, π);   ρ = n · (first − origin)

    Args:
        first_m: [..., 2] a point of the line, metres.
        second_m: [..., 2] another point; coincident points give (0, 0).
        origin_m: [2] the point that ρ is measured from.

    Returns:
        rho_m [...] and theta_rad [...].

    Example:
        >>> rho, theta = line_through(jnp.array([0.0, 5.0]), jnp.array([1.0, 5.0]), jnp.zeros(2))
        >>> print(f"{rho:.1f} {theta:.4f}")
        5.0 1.5708

    Source: neutrosophic Hough transform (2018), equations 6–12.

    Note:
        The paper prints an absolute value in (10) and swaps the cases of (9); ρ is signed here,
        since |ρ| folds lines of negative ρ onto other ones.
    """
    along = second_m - first_m
    length = safe_norm(along)
    normal_x = safe_divide(-along[..., 1], length)
    normal_y = safe_divide(along[..., 0], length)
    flip = (normal_y < 0) | ((normal_y == 0) & (normal_x < 0))
    sign = jnp.where(flip, -1.0, 1.0).astype(length.dtype)
    theta = safe_arctan2(sign * normal_y, sign * normal_x)
    offset = first_m - jnp.broadcast_to(origin_m, first_m.shape)
    rho = sign * (normal_x * offset[..., 0] + normal_y * offset[..., 1])
    return wrap_line(rho, theta)  # a normal that points down by less than rounding gives θ = π


def line_difference(
    rho_m: Array, theta_rad: Array, other_rho_m: Array, other_theta_rad: Array
) -> tuple[Array, Array]:
    """Return (Δρ, Δθ) between two lines, taking the nearer of the other's two names.

    Args:
        rho_m: [...] first line.
        theta_rad: [...] in [0, π).
        other_rho_m: [...] second line.
        other_theta_rad: [...] in [0, π).

    Returns:
        Δρ [...] in metres and Δθ [...] in [−π/2, π/2].

    Example:
        >>> d_rho, d_theta = line_difference(
        ...     jnp.array(3.0), jnp.array(0.01), jnp.array(-3.0), jnp.array(3.13)
        ... )
        >>> print(f"{d_rho:.1f} {d_theta:.4f}")
        0.0 0.0216
    """
    d_theta = theta_rad - other_theta_rad
    half_turn = jnp.asarray(jnp.pi, d_theta.dtype)
    twin = jnp.abs(d_theta) > half_turn / 2
    d_theta = jnp.where(twin, d_theta - half_turn * jnp.sign(d_theta), d_theta)
    d_rho = jnp.where(twin, rho_m + other_rho_m, rho_m - other_rho_m)
    return d_rho, d_theta


def wrap_line(rho_m: Array, theta_rad: Array) -> tuple[Array, Array]:
    """Return the name of a line with θ in [0, π), for θ at most half a turn outside.

    Example:
        >>> rho, theta = wrap_line(jnp.array(3.0), jnp.array(-0.5))
        >>> print(f"{rho:.1f} {theta:.4f}")
        -3.0 2.6416
    """
    half_turn = jnp.asarray(jnp.pi, theta_rad.dtype)
    below = theta_rad < 0
    rho, theta = jnp.where(below, -rho_m, rho_m), jnp.where(below, theta_rad + half_turn, theta_rad)
    above = theta >= half_turn  # also where a tiny negative θ was rounded up to π
    return jnp.where(above, -rho, rho), jnp.where(above, theta - half_turn, theta)


def point_line_distance(rho_m: Array, theta_rad: Array, position_m: Array) -> Array:
    """Return the signed distance n · z − ρ of points from a line, metres.

    Args:
        rho_m: [...] measured from (0, 0).
        theta_rad: [...].
        position_m: [..., 2].

    Example:
        >>> at = jnp.array([[4.0, 7.0], [4.0, 5.0]])
        >>> print(point_line_distance(jnp.array(5.0), jnp.array(jnp.pi / 2), at).round(3))
        [2. 0.]
    """
    return jnp.cos(theta_rad) * position_m[..., 0] + jnp.sin(theta_rad) * position_m[..., 1] - rho_m


def line_covariance(
    first_m: Array, second_m: Array, origin_m: Array, sigma_m: Array
) -> tuple[Array, Array, Array]:
    """Return var ρ, cov(ρ, θ) and var θ of the line through two noisy points.

        var θ = 2σ²/L²,  var ρ = σ²(1 + 2α + 2α²),  cov = −σ²(1 + 2α)/L,  α = a/L

    with L the signed length along u = (sin θ, −cos θ) and a the first point's coordinate on it.

    Args:
        first_m: [..., 2] first point, metres.
        second_m: [..., 2] second point.
        origin_m: [2] the point that ρ is measured from.
        sigma_m: [] standard deviation of each coordinate of both points.

    Returns:
        Three arrays [...] in m², m·rad and rad²; coincident points give (σ², 0, 0).

    Example:
        >>> var_rho, cov, var_theta = line_covariance(
        ...     jnp.array([0.0, 0.0]), jnp.array([100.0, 0.0]), jnp.zeros(2), jnp.array(1.0)
        ... )
        >>> print(f"{var_rho:.1f} {abs(cov):.3f} {var_theta:.4f}")
        1.0 0.010 0.0002

    Source: first-order propagation of equations 9–12 of the neutrosophic Hough transform (2018).
    """
    along = second_m - first_m
    flip = (along[..., 0] < 0) | ((along[..., 0] == 0) & (along[..., 1] > 0))
    sign = jnp.where(flip, -1.0, 1.0).astype(along.dtype)
    length = sign * safe_norm(along)
    unit = safe_divide(along, length[..., None])
    offset = ((first_m - jnp.broadcast_to(origin_m, first_m.shape)) * unit).sum(-1)
    ratio = safe_divide(offset, length)
    variance = sigma_m**2
    var_theta = 2 * safe_divide(variance, length**2)
    covariance = -variance * safe_divide(1 + 2 * ratio, length)
    var_rho = variance * (1 + 2 * ratio + 2 * ratio**2)
    return var_rho, covariance, var_theta
