"""What a mechanically scanned sonar hears, ping by ping.

Every ping has its own time and pose. The power that cell (q, r) of ping q and range bin r gets is

    p_qr = Σ_i 10^((L_i + σ_F n_i)/10) (10 m / R_i) w_i b²(α_i, Δ) b²(ε_i, Δ') T(R_i / δ − r − ½),

i running over facets of the objects, R the slant range, α and ε bearing and elevation off the
beam's axis, b² the two-way pattern, δ the length of a bin, and T a triangle, 1 at its middle and 0
a bin off: the pulse is as long as a bin. Reverberation of power 1 and shape ν is laid over it, see
`echoes`. The gain levels the reverberation, whose cells grow with the range: so an object's level
falls by 1 / R.

Nothing casts a shadow, and nothing echoes twice.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.frames import earth_to_polar, polar_to_earth
from jaxtrack.numerics.checks import check_array, check_mask, check_positive, check_size
from jaxtrack.numerics.safe import safe_arctan2, safe_divide, safe_norm
from jaxtrack.sensors.echoes import reverberate
from jaxtrack.sensors.scanning_sonar import IMAGENEX_881L, PingSizes, ScanningSonar
from jaxtrack.types import Array, Key, Pings, Pose

REFERENCE_M = 10.0  # where an object's level is measured
_HALF_POWER = 0.442946  # sinc²(0.442946) = ½


class Cylinders(NamedTuple):
    """Upright cylinders where each ping finds them. Traced."""

    position_m: Array  # [Q, K, 2] of their axes, in the earth frame
    mask: Array  # [Q, K]
    radius_m: Array  # [K]
    level_db: Array  # [K] median power at 10 m on the axis, all facets together, over reverberation
    depth_m: Array  # [K] below the sonar; negative above it


class Dike(NamedTuple):
    """A slope without ends, whose foot is the line ρ = x cos θ + y sin θ. Traced."""

    rho_m: Array | float
    theta_rad: Array | float
    level_db: Array | float = 24.0  # of a beam that strikes it square, at any range
    slope_m: Array | float = 0.6  # from its foot to where the water ends: stones echo all over it


def beam_pattern(angle_rad: Array, width_rad: Array | float) -> Array:
    """Return the two-way power pattern b² of an even aperture, sinc⁴; ¼ at half the width, [...].

    Args:
        angle_rad: [...] off the axis; behind the sonar nothing is heard.
        width_rad: between the half powers of the one-way pattern.

    Example:
        >>> print(beam_pattern(jnp.array([0.0, 0.5, 1.0]), 1.0).round(2))
        [1.   0.25 0.  ]
    """
    dtype = angle_rad.dtype
    half = jnp.sin(jnp.asarray(width_rad, dtype) / 2)
    one_way = jnp.sinc(_HALF_POWER * jnp.sin(angle_rad) / half) ** 2
    return jnp.where(jnp.cos(angle_rad) > 0, one_way**2, 0.0)


def observe_pings(
    key: Key,
    time_s: Array,
    bearing_rad: Array,
    pose: Pose,
    cylinders: Cylinders,
    sonar: ScanningSonar,
    *,
    dike: Dike | None = None,
    sizes: PingSizes = IMAGENEX_881L.sizes,
) -> Pings:
    """Return the echoes of Q pings, amplitudes in R range bins; reverberation has mean square 1.

    Bin r reaches from r to r + 1 bins' lengths. A cylinder's arc is what faces the sonar; its
    facets are even in projected width and weigh by the cosine of incidence.

    Args:
        key: random key.
        time_s: [Q].
        bearing_rad: [Q] of the beam from the sonar's own ahead.
        pose: the carrier's true one, at every ping.
        cylinders: K of them, where every ping finds them.
        sonar: what it is.
        dike: None: open water.
        sizes: bins, facets, rays and shape count; the number of pings is that of the times.

    Returns:
        Pings, all live, that carry the true pose.

    Raises:
        ValueError: shapes that do not fit each other, or a known value that cannot be.
        TypeError: a mask of numbers.

    Example:
        >>> from jaxtrack.sensors import sweeps
        >>> _, bearing_rad = sweeps(ScanningSonar(), frames=1)
        >>> pose = Pose(jnp.zeros((101, 2)), jnp.zeros(101))
        >>> bucket = Cylinders(jnp.tile(jnp.array([12.0, 0.0]), (101, 1, 1)),
        ...                    jnp.ones((101, 1), bool), jnp.array([0.39]), jnp.array([40.0]),
        ...                    jnp.zeros(1))
        >>> seen = observe_pings(jax.random.key(0), jnp.arange(101.0), bearing_rad[0], pose, bucket,
        ...                      ScanningSonar(mount_m=(0.0, 0.0), mount_rad=0.0))
        >>> print(seen.intensity.shape, jnp.unravel_index(seen.intensity.argmax(), (101, 500))[1])
        (101, 500) 145

    Source: Zernike moment paper (2023), section 2.2.
    """
    check_array("time_s", time_s, shape=("Q",))
    pings = time_s.shape[0]
    check_array("bearing_rad", bearing_rad, shape=(pings,))
    check_array("pose.position_m", pose.position_m, shape=(pings, 2))
    check_array("pose.heading_rad", pose.heading_rad, shape=(pings,))
    check_array("cylinders.position_m", cylinders.position_m, shape=(pings, "K", 2))
    kinds = cylinders.position_m.shape[1]
    check_mask("cylinders.mask", cylinders.mask, shape=(pings, kinds))
    for name in ("radius_m", "level_db", "depth_m"):
        check_array(f"cylinders.{name}", getattr(cylinders, name), shape=(kinds,))
    for name, size in zip(sizes._fields, sizes, strict=True):
        check_size(f"sizes.{name}", size)
    dtype = pose.position_m.dtype
    for name in ("range_max_m", "beam_rad", "beam_up_rad"):
        check_positive(f"sonar.{name}", getattr(sonar, name), dtype)

    keys = jax.random.split(key, 3)
    axis_rad = bearing_rad + jnp.asarray(sonar.mount_rad, dtype)
    echoes = [_cylinder_echoes(keys[0], axis_rad, pose, cylinders, sonar, sizes.facets)]
    if dike is not None:
        echoes.append(_dike_echoes(keys[1], axis_rad, pose, dike, sonar, sizes.rays))
    range_m, echo = (jnp.concatenate(x, axis=1) for x in zip(*echoes, strict=True))
    power = _into_bins(range_m * sizes.bins / jnp.asarray(sonar.range_max_m, dtype), echo, sizes)
    intensity = reverberate(keys[2], power, shape=sizes.shape)
    return Pings(time_s, bearing_rad, intensity, jnp.ones(pings, bool), pose)


def _cylinder_echoes(
    key: Key, axis_rad: Array, pose: Pose, cylinders: Cylinders, sonar: ScanningSonar, facets: int
) -> tuple[Array, Array]:
    """Return slant range and power of every facet, each [Q, K · facets]."""
    dtype = pose.position_m.dtype
    pings, kinds = cylinders.mask.shape
    centre_m = jnp.where(cylinders.mask[..., None], cylinders.position_m, 0.0)
    mount_m = jnp.asarray(sonar.mount_m, dtype)
    polar = jax.vmap(earth_to_polar, (0, 0, None))
    far_m, bearing_rad = polar(centre_m, pose, mount_m)  # [Q, K]
    across = 2 * (jnp.arange(facets).astype(dtype) + 0.5) / facets - 1
    ahead = jnp.sqrt(1 - across**2)  # the cosine of incidence
    radius_m = cylinders.radius_m.astype(dtype)[None, :, None]
    nearer_m = far_m[..., None] - radius_m * ahead[None, None]
    aside_m = radius_m * across[None, None]
    flat_m = safe_norm(jnp.stack([nearer_m, jnp.broadcast_to(aside_m, nearer_m.shape)], axis=-1))
    off_rad = bearing_rad[..., None] + safe_arctan2(
        jnp.broadcast_to(aside_m, nearer_m.shape), nearer_m
    )
    depth_m = jnp.broadcast_to(cylinders.depth_m.astype(dtype)[None, :, None], flat_m.shape)
    slant_m = safe_norm(jnp.stack([flat_m, depth_m], axis=-1))
    heard = beam_pattern(off_rad - axis_rad[:, None, None], sonar.beam_rad)
    heard *= beam_pattern(safe_arctan2(depth_m, flat_m), sonar.beam_up_rad)
    noise = jax.random.normal(key, (pings, kinds), dtype)
    level_db = (
        cylinders.level_db.astype(dtype)[None] + jnp.asarray(sonar.fluctuation_db, dtype) * noise
    )
    level = jnp.where(cylinders.mask, 10 ** (level_db / 10), 0.0)
    weight = (ahead / ahead.sum())[None, None]
    power = level[..., None] * weight * heard * safe_divide(REFERENCE_M, slant_m)
    return slant_m.reshape(pings, -1), power.reshape(pings, -1)


def _dike_echoes(
    key: Key, axis_rad: Array, pose: Pose, dike: Dike, sonar: ScanningSonar, rays: int
) -> tuple[Array, Array]:
    """Return range and power of where a beam's rays strike, each [Q, rays]."""
    dtype = pose.position_m.dtype
    width_rad = jnp.asarray(sonar.beam_rad, dtype)
    off_rad = (2 * (jnp.arange(rays).astype(dtype) + 0.5) / rays - 1) * width_rad
    share = beam_pattern(off_rad, width_rad)
    theta_rad = jnp.asarray(dike.theta_rad, dtype)
    normal = jnp.stack([jnp.cos(theta_rad), jnp.sin(theta_rad)])
    zero = jnp.zeros((), dtype)
    stand_m = jax.vmap(lambda at: polar_to_earth(zero, zero, at, sonar.mount_m))(pose)
    way_m = jnp.asarray(dike.rho_m, dtype) - (stand_m * normal[None]).sum(axis=-1)  # [Q]
    ray_rad = (pose.heading_rad + axis_rad)[:, None] + off_rad[None]
    facing = jnp.cos(ray_rad - theta_rad)  # the rate at which a ray nears the wall's line
    keys = jax.random.split(key)
    up_m = jnp.asarray(dike.slope_m, dtype) * jax.random.uniform(keys[0], ray_rad.shape, dtype)
    range_m = safe_divide(way_m[:, None] + up_m, facing, jnp.inf)
    noise = jax.random.normal(keys[1], range_m.shape, dtype)
    level_db = jnp.asarray(dike.level_db, dtype) + jnp.asarray(sonar.fluctuation_db, dtype) * noise
    power = 10 ** (level_db / 10) * (share / share.sum())[None] * jnp.abs(facing)
    return range_m, jnp.where(range_m > 0, power, 0.0)


def _into_bins(place: Array, power: Array, sizes: PingSizes) -> Array:
    """Return the power in each bin, [Q, R], of echoes at places counted in bins, [Q, I].

    An echo as long as a bin lies in the two bins it overlaps, each with its share.
    """
    bins = sizes.bins
    inside = (place >= 0) & (place < bins)
    place = jnp.where(inside, place, 0.0) - 0.5
    power = jnp.where(inside, power, 0.0)
    lower = jnp.floor(place)
    upper_share = place - lower
    row = bins * jnp.arange(place.shape[0], dtype=jnp.int32)[:, None]
    # Half a bin at either end overlaps nothing that is recorded; it goes to the bin beside it.
    first = lower.astype(jnp.int32)
    cell = jnp.stack([row + first.clip(0, bins - 1), row + (first + 1).clip(0, bins - 1)])
    share = jnp.stack([(1 - upper_share) * power, upper_share * power])
    flat = jnp.zeros(place.shape[0] * bins, power.dtype)
    return flat.at[cell.ravel()].add(share.ravel()).reshape(-1, bins)
