"""The steps that are the Zernike paper's own: how alike is alike, and where a particle steps."""

import math

import jax.numpy as jnp

from jaxtrack.numerics.safe import safe_norm
from jaxtrack.types import Array


def similarity_angle(feature: Array, template: Array) -> Array:
    """Return the angle between two feature vectors, [].

        α = arccos(A · B / (|A| |B|)) = 2 arctan2(|â − b̂|, |â + b̂|)

    Args:
        feature: [F]; one of zeros is at a right angle to everything.
        template: [F].

    Example:
        >>> print(similarity_angle(jnp.array([1.0, 0.0]), jnp.array([3.0, 3.0])).round(4))
        0.7854

    Source: Zernike moment paper (2023), equations 27 and 28. The second form is exact and
        differentiable near zero, where the first is neither.
    """
    unit = lambda x: x / jnp.where(safe_norm(x) > 0, safe_norm(x), 1.0)
    a, b = unit(feature), unit(template)
    apart, together = safe_norm(a - b), safe_norm(a + b)
    none = (apart == 0) & (together == 0)
    angle = 2 * jnp.arctan2(apart, jnp.where(none, 1.0, together))
    return jnp.where(none, math.pi / 2, angle)


def first_threshold(angle_rad: Array, there: Array) -> Array:
    """Return α_threshold: of the angles that are there, sorted, the one at two thirds.

    Args:
        angle_rad: [N] of the first weighting.
        there: [N] which windows had points enough.

    Example:
        >>> angle = jnp.array([0.1, 0.6, 0.2, 0.3, 0.5, 0.4, 9.0])
        >>> print(first_threshold(angle, angle < 1))
        0.4

    Source: Zernike moment paper (2023), section 2.3.4.

    Note:
        Windows with fewer than three points do not count; the paper does not know them.
    """
    ordered = jnp.sort(jnp.where(there, angle_rad, jnp.inf))
    count = there.sum(dtype=jnp.int32)
    value = ordered[jnp.maximum((2 * count + 2) // 3 - 1, 0)]
    return jnp.where(count > 0, value, math.pi)


def angle_log_likelihood(angle_rad: Array, threshold_rad: Array, sigma: Array | float) -> Array:
    """Return log p(z | x) of particles by their angles.

        MAD = (α_threshold − α) / α_threshold,   p ∝ exp(MAD / (2σ²)),   0 where α ≥ α_threshold

    Args:
        angle_rad: [N].
        threshold_rad: [] α_threshold.
        sigma: [] σ.

    Example:
        >>> print(angle_log_likelihood(jnp.array([0.1, 0.5]), jnp.array(0.4), 0.5))
        [ 1.5 -inf]

    Source: Zernike moment paper (2023), equations 29 and 30; the extraction of 30 lacks the sign,
        which has to be plus for alike windows to weigh more.
    """
    sigma = jnp.asarray(sigma, angle_rad.dtype)
    some = threshold_rad > 0
    share = (threshold_rad - angle_rad) / jnp.where(some, threshold_rad, 1.0)
    return jnp.where(some & (angle_rad < threshold_rad), share / (2 * sigma**2), -jnp.inf)


def aligned(step_m: Array, apart_m: Array) -> Array:
    """Return a step that is turned towards where the target went.

    Both coordinates get the signs of the target's. Where it moves more along x, |arctan(Δy/Δx)|
    below 30°, the larger one becomes the x coordinate, and likewise for y, above 60°.

    Args:
        step_m: [2] drawn.
        apart_m: [2] between the target's last two places.

    Example:
        >>> print(aligned(jnp.array([0.1, 0.5]), jnp.array([-2.0, 0.3])))
        [-0.5  0.1]

    Source: Zernike moment paper (2023), section 2.3.3, mode 2.

    Note:
        The paper compares an arctan of less than 90° with 150° and 120°; between 30° and 60° it
        says nothing, and here the signs alone are set.
    """
    size, (dx, dy) = jnp.abs(step_m), jnp.abs(apart_m)
    small, large = jnp.sort(size)
    slope = math.tan(math.radians(30.0))
    along_x, along_y = dy < slope * dx, dx < slope * dy
    size = jnp.where(along_x, jnp.stack([large, small]), size)
    size = jnp.where(along_y, jnp.stack([small, large]), size)
    return jnp.where(apart_m < 0, -size, size)
