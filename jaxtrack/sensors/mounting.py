"""Mounting calibration: how far a sonar is turned in its carrier, by sightings of a fixed target.

A target that the sonar sees at s_i, in its own frame, stands at the same place of the earth from
every pose i of the carrier,

    p_i + R(ψ_i) (R(β) s_i + t) = x   for all i,

with t the lever arm. β is what is looked for; it turns clockwise, as headings do.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array, check_mask
from jaxtrack.numerics.safe import safe_arctan2, safe_divide, safe_norm
from jaxtrack.types import Array, Pose


class Sightings(NamedTuple):
    """One fixed target, seen from several poses."""

    range_m: Array  # [N]
    bearing_rad: Array  # [N] in the sonar's own frame
    pose: Pose  # position_m [N, 2], heading_rad [N]


class Mounting(NamedTuple):
    """How the sonar is mounted, and what stands behind it."""

    mount_rad: Array  # [] β in [−π, π]
    target_m: Array  # [2] where the target then is
    residual_m: Array  # [] root mean square of what the sightings differ by from it
    valid: Array  # [] False: the sightings say nothing about β, which is then 0


def mounting_by_triangle(sightings: Sightings) -> Array:
    """Return β from two sightings by the paper's triangle, radians in [−π, π].

        γ = atan2(y_C − y_B, x_C − x_B)
        ∠CBA = arccos((a² + c² − b²) / 2ac),   a = |BC|, b = |CA|, c = |AB|
        α = atan2(y_A, x_A)
        θ = α − s ∠CBA,   s = sign(x_B y_C − y_B x_C) of the sonar's vectors to A at B and at C
        β = γ − yaw − θ

    Args:
        sightings: two, from B and from C.

    Example:
        >>> pose = Pose(jnp.array([[0.0, 0.0], [3.0, 0.0]]), jnp.zeros(2))
        >>> seen = Sightings(jnp.array([5.0, 4.0]),
        ...                  jnp.array([jnp.arctan2(4.0, 3.0), jnp.pi / 2]) + 0.1, pose)
        >>> print(mounting_by_triangle(seen).round(3))
        -0.1

    Source: Zernike moment paper (2023), equations 1–5.

    Note:
        The paper gives θ = α − ∠CBA without the sign, which is that of a target to starboard of the
        way from B to C. The triangle knows nothing of the lever arm and takes the yaw at C for that
        at B: β is exact where the yaws are equal, and off by some of their difference elsewhere.
        Where B is C it says nothing, without a word; `mounting_of_sightings` does.
    """
    _check(sightings, 2)
    position_m = sightings.pose.position_m
    way_m = position_m[1] - position_m[0]
    seen_m = _seen(sightings)
    a, (c, b) = safe_norm(way_m), sightings.range_m
    cosine = safe_divide(a**2 + c**2 - b**2, 2 * a * c)
    # arccos as atan2, whose gradient is finite where the triangle is flat.
    corner = safe_arctan2(jnp.sqrt(jnp.maximum(1 - cosine**2, jnp.finfo(a.dtype).tiny)), cosine)
    cross = seen_m[0, 0] * seen_m[1, 1] - seen_m[0, 1] * seen_m[1, 0]
    side = jnp.where(cross < 0, -1.0, 1.0).astype(cross.dtype)  # a flat triangle has either
    gamma = safe_arctan2(way_m[1], way_m[0])
    beta = gamma - sightings.pose.heading_rad[0] - (sightings.bearing_rad[0] - side * corner)
    return jnp.arctan2(jnp.sin(beta), jnp.cos(beta))


def mounting_of_sightings(
    sightings: Sightings, mount_m: Array | tuple[float, float], mask: Array | None = None
) -> Mounting:
    """Return the β of least squares over many sightings at any yaws, in closed form.

        min over β, x of Σ_i |p_i + R(ψ_i) t + R(β) v_i − x|²,   v_i = R(ψ_i) s_i

    With x eliminated this is the turn that lays one cloud of points on another,

        β = atan2(Σ ṽ_i × q̃_i, Σ ṽ_i · q̃_i),   q_i = −(p_i + R(ψ_i) t),

    tildes being differences from the means. Of two sightings this is the solution of

        [u, J u] [cos β, sin β]ᵀ = p_C − p_B + (R(ψ_C) − R(ψ_B)) t,   u = v_B − v_C,  J = R(π/2),

    for the matrix turns and stretches, and its inverse is its transpose over |u|².

    Args:
        sightings: N ≥ 2, in poses that differ.
        mount_m: [2] t, where the sonar sits in the body frame.
        mask: [N] which count; None: all.

    Example:
        >>> pose = Pose(jnp.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]]), jnp.zeros(3))
        >>> seen = Sightings(jnp.array([5.0, 4.0, 3.0]),
        ...                  jnp.array([jnp.arctan2(4.0, 3.0), jnp.pi / 2, 0.0]) + 0.1, pose)
        >>> found = mounting_of_sightings(seen, (0.0, 0.0))
        >>> print(*(f"{x:.3f}" for x in (found.mount_rad, *found.target_m)), found.valid)
        -0.100 3.000 4.000 True

    Source: the readings of the Zernike moment paper (2023), section 2.2.2; not the paper's.
    """
    _check(sightings)
    number = sightings.range_m.shape[0]
    count = jnp.ones(number, bool) if mask is None else mask
    check_mask("mask", count, shape=(number,))
    dtype = sightings.range_m.dtype
    clean = lambda x: jnp.where(count.reshape(-1, *[1] * (x.ndim - 1)), x, 0.0)
    sightings = Sightings(
        clean(sightings.range_m),
        clean(sightings.bearing_rad),
        Pose(clean(sightings.pose.position_m), clean(sightings.pose.heading_rad)),
    )
    heading_rad = sightings.pose.heading_rad
    arm_m = jnp.broadcast_to(jnp.asarray(mount_m, dtype)[None], (number, 2))
    stand_m = sightings.pose.position_m + _turn(arm_m, heading_rad)
    seen_m = _turn(_seen(sightings), heading_rad)
    weight = safe_divide(count.astype(dtype), count.sum().astype(dtype))[:, None]
    middle_m, seen_middle_m = (weight * stand_m).sum(axis=0), (weight * seen_m).sum(axis=0)
    q = weight * (middle_m[None] - stand_m)
    v = seen_m - seen_middle_m[None]
    along = (v * q).sum()
    across = (v[:, 0] * q[:, 1] - v[:, 1] * q[:, 0]).sum()
    # Rounding leaves this much of a correlation that is none.
    least = 64 * jnp.finfo(dtype).eps * (weight * (stand_m**2 + seen_m**2)).sum()
    valid = jnp.hypot(along, across) > least
    beta = jnp.where(valid, safe_arctan2(across, along), 0.0)
    target_m = middle_m + _turn(seen_middle_m[None], beta[None])[0]
    turned_m = _turn(seen_m, jnp.broadcast_to(beta, heading_rad.shape))
    off_m = safe_norm(stand_m + turned_m - target_m[None])
    residual_m = safe_norm(jnp.sqrt(weight[:, 0]) * off_m)
    return Mounting(beta, target_m, residual_m, valid)


def _check(sightings: Sightings, number: int | str = "N") -> None:
    check_array("sightings.range_m", sightings.range_m, shape=(number,))
    size = sightings.range_m.shape[0]
    check_array("sightings.bearing_rad", sightings.bearing_rad, shape=(size,))
    check_array("sightings.pose.position_m", sightings.pose.position_m, shape=(size, 2))
    check_array("sightings.pose.heading_rad", sightings.pose.heading_rad, shape=(size,))


def _seen(sightings: Sightings) -> Array:
    """Return the target in the sonar's frame, [N, 2]."""
    bearing_rad = sightings.bearing_rad
    unit = jnp.stack([jnp.cos(bearing_rad), jnp.sin(bearing_rad)], axis=-1)
    return sightings.range_m[:, None] * unit


def _turn(vector: Array, angle_rad: Array) -> Array:
    """Return R(angle) vector, [N, 2]."""
    cos, sin = jnp.cos(angle_rad), jnp.sin(angle_rad)
    x, y = vector[:, 0], vector[:, 1]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
