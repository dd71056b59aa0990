"""Straight lines ρ = x cos θ + y sin θ, ρ signed, θ in [0, π): equations 6 to 12, repaired."""

import math

import numpy as np


def wrap(rho, theta):
    """Return the representation of (ρ, θ) ~ (−ρ, θ ± π) whose θ is in [0, π)."""
    while theta < 0.0:
        rho, theta = -rho, theta + math.pi
    while theta >= math.pi:  # −1e-20 + π is π
        rho, theta = -rho, theta - math.pi
    return rho, theta


def normal_of(a, b):
    """Return the unit normal of the line through a and b, flipped so that its θ is in [0, π)."""
    d_x, d_y = float(b[0] - a[0]), float(b[1] - a[1])
    length = math.hypot(d_x, d_y)
    if length == 0.0:
        raise ValueError("coincident points have no line")
    n_x, n_y = -d_y / length, d_x / length
    if n_y < 0.0 or (n_y == 0.0 and n_x < 0.0):
        n_x, n_y = -n_x, -n_y
    return n_x, n_y + 0.0  # + 0.0 turns −0.0 into 0.0


def line_through(a, b, origin):
    """Return signed (ρ, θ) of the line through a and b, ρ from `origin`: equations 9 and 10."""
    n_x, n_y = normal_of(a, b)
    rho = n_x * (a[0] - origin[0]) + n_y * (a[1] - origin[1])
    # atan2(tiny, −1) rounds up to π, which is outside [0, π): hence the wrap.
    return wrap(float(rho), math.atan2(n_y, n_x))


def measured_from_zero(rho, theta, origin):
    """Return ρ of the same line measured from (0, 0) instead of `origin`: equation 6."""
    return rho + origin[0] * math.cos(theta) + origin[1] * math.sin(theta)


def is_twinned(theta_p, theta_q):
    """Return whether q is compared with p as its twin (−ρ, θ ± π)."""
    return abs(theta_p - theta_q) > math.pi / 2


def difference(rho_p, theta_p, rho_q, theta_q):
    """Return p − q, q as the one of its two representations nearer to p in θ: equation 15."""
    d_theta = theta_p - theta_q
    if is_twinned(theta_p, theta_q):
        return rho_p + rho_q, d_theta - math.copysign(math.pi, d_theta)
    return rho_p - rho_q, d_theta


def line_covariance(a, b, origin, sigma):
    """Return the 2×2 covariance of (ρ, θ) (equations 9, 10) for noise σ on each coordinate of a, b.

    With u along the line and dn/dθ = −u, moving a by e_a and b by e_b along n gives
    dθ = (e_b − e_a) / L and dρ = (1 + s/L) e_a − (s/L) e_b; s is a's coordinate along u.
    """
    n_x, n_y = normal_of(a, b)
    u_x, u_y = n_y, -n_x
    length = (b[0] - a[0]) * u_x + (b[1] - a[1]) * u_y
    s = (a[0] - origin[0]) * u_x + (a[1] - origin[1]) * u_y
    of_a = np.array([1.0 + s / length, -1.0 / length])
    of_b = np.array([-s / length, 1.0 / length])
    return sigma**2 * (np.outer(of_a, of_a) + np.outer(of_b, of_b))


def summed_covariance(covariance_p, theta_p, covariance_q, theta_q):
    """Return C_p + C_q in p's representation, the scale of equation 27.

    As a twin q's ρ changes its sign and its θ does not, and so does the covariance of the two.
    """
    covariance_q = np.array(covariance_q, dtype=np.float64)
    if is_twinned(theta_p, theta_q):
        covariance_q[0, 1] *= -1.0
        covariance_q[1, 0] *= -1.0
    return np.asarray(covariance_p, dtype=np.float64) + covariance_q


def tolerance_scale(eps_rho, eps_theta):
    """Return S = diag(ε_ρ², ε_θ²), the scale of equations 15 and 27."""
    return np.array([[eps_rho**2, 0.0], [0.0, eps_theta**2]])


def gaussian(d_rho, d_theta, scale):
    """Return exp(−½ Δᵀ S⁻¹ Δ): equation 15, and 27."""
    (s_rr, s_rt), (_, s_tt) = scale
    quadratic = s_tt * d_rho**2 - 2.0 * s_rt * d_rho * d_theta + s_rr * d_theta**2
    return math.exp(-0.5 * quadratic / (s_rr * s_tt - s_rt**2))


def in_box(d_rho, d_theta, scale):
    """Return whether Δ is within two standard deviations on each axis: equation 28."""
    return abs(d_rho) <= 2.0 * math.sqrt(scale[0][0]) and abs(d_theta) <= 2.0 * math.sqrt(
        scale[1][1]
    )
