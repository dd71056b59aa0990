"""From a sweep's intensities to a cloud of points: threshold, and each ping's own pose."""

import jax
import jax.numpy as jnp

from jaxtrack.models.frames import polar_to_earth
from jaxtrack.numerics.checks import check_array, check_mask, check_positive, check_size
from jaxtrack.numerics.masked import masked_min
from jaxtrack.sensors.scanning_sonar import ScanningSonar
from jaxtrack.types import Array, Pings, Pose, Scan


def cloud_of_pings(
    pings: Pings, sonar: ScanningSonar, threshold: Array | float = 4.0, *, points: int = 512
) -> tuple[Scan, Array]:
    """Return the cells of a sweep that are loud as points in the earth frame, and an overflow flag.

        a_qr ≥ γ:   x = p_q + R(ψ_q) (R(β) r_r [cos α_q, sin α_q]ᵀ + t),   w = 1 − (γ / a_qr)²

    r_r is the middle of the bin. The weight is the share of a cell's power beyond the threshold, 0
    at it, so that a cell comes and goes without a jump. Stacked sweeps:
    `jax.vmap(cloud_of_pings, (0, None, None))(pings, sonar, threshold)`.

    Args:
        pings: Q pings of R bins, of one sweep, with the poses that are known.
        sonar: its scope and mounting.
        threshold: γ > 0; the mean square of simulated reverberation is 1, and at 4, 12 dB over it,
            one cell in 7 000 is louder (ν = 3).
        points: P places for points, static.

    Returns:
        A scan of P points in no promised order, at the time of the first live ping, with each
        point's own delay, intensity and weight; and whether more than P cells were loud. Then the
        nearest of them by range are kept: if the loudest were, a dike could crowd out a target.

    Raises:
        ValueError: a shape that does not fit, or a known threshold that is not positive.
        TypeError: a mask of numbers, a size that is no int.

    Example:
        >>> pose = Pose(jnp.zeros((2, 2)), jnp.array([0.0, jnp.pi / 2]))
        >>> pings = Pings(jnp.array([5.0, 6.0]), jnp.zeros(2), jnp.array([[0.0, 8.0], [5.0, 0.0]]),
        ...               jnp.ones(2, bool), pose)
        >>> sonar = ScanningSonar(range_max_m=4.0, mount_m=(0.0, 0.0), mount_rad=0.0)
        >>> scan, overflow = cloud_of_pings(pings, sonar, points=3)
        >>> print(*(f"{x:.1f}" for x in jnp.linalg.norm(scan.position_m, axis=1)), scan.mask)
        1.0 3.0 0.0 [ True  True False]

    Source: Zernike moment paper (2023), figure 3 and equation 6.
    """
    check_array("pings.intensity", pings.intensity, shape=("Q", "R"))
    number, bins = pings.intensity.shape
    check_array("pings.time_s", pings.time_s, shape=(number,))
    check_array("pings.bearing_rad", pings.bearing_rad, shape=(number,))
    check_mask("pings.mask", pings.mask, shape=(number,))
    check_array("pings.pose.position_m", pings.pose.position_m, shape=(number, 2))
    check_array("pings.pose.heading_rad", pings.pose.heading_rad, shape=(number,))
    check_size("points", points)
    pings = sound_pings(pings)
    dtype = pings.intensity.dtype
    gamma = check_positive("threshold", threshold, dtype)
    bin_m = check_positive("sonar.range_max_m", sonar.range_max_m, dtype) / bins

    loud = (pings.intensity >= gamma) & jnp.isfinite(pings.intensity) & pings.mask[:, None]
    # By range first: the place of the k-th loud cell is where the count of them reaches k.
    count = jnp.cumsum(loud.T.ravel().astype(jnp.int32))
    rank = jnp.arange(points, dtype=jnp.int32)
    mask = rank < count[-1]
    cell = jnp.where(mask, jnp.searchsorted(count, rank + 1), 0).astype(jnp.int32)
    ping, place = cell % number, cell // number
    range_m = bin_m * (place.astype(dtype) + 0.5)
    clean = lambda x: jnp.where(mask.reshape(-1, *[1] * (x.ndim - 1)), x[ping], 0.0)
    pose = Pose(clean(pings.pose.position_m), clean(pings.pose.heading_rad))
    bearing_rad = clean(pings.bearing_rad) + jnp.asarray(sonar.mount_rad, dtype)
    mount_m = jnp.asarray(sonar.mount_m, dtype)
    position_m = jax.vmap(polar_to_earth, (0, 0, 0, None))(range_m, bearing_rad, pose, mount_m)
    intensity = jnp.where(mask, pings.intensity[ping, place], 0.0)
    weight = jnp.where(mask, 1 - (gamma / jnp.where(mask, intensity, gamma)) ** 2, 0.0)
    time_s = masked_min(pings.time_s, pings.mask)
    scan = Scan(
        time_s,
        pings.mask.any(),
        jnp.where(mask[:, None], position_m, 0.0),
        mask,
        weight=weight,
        delay_s=jnp.where(mask, clean(pings.time_s) - time_s, 0.0),
        intensity=intensity,
    )
    return scan, count[-1] > points


def sound_pings(pings: Pings) -> Pings:
    """Return pings of which only those count that have a time, a bearing and a pose.

    Example:
        >>> pose = Pose(jnp.zeros((2, 2)), jnp.array([0.0, jnp.nan]))
        >>> pings = Pings(jnp.zeros(2), jnp.zeros(2), jnp.ones((2, 3)), jnp.ones(2, bool), pose)
        >>> print(sound_pings(pings).mask)
        [ True False]
    """
    pose = pings.pose
    finite = jnp.isfinite(pings.time_s) & jnp.isfinite(pings.bearing_rad)
    finite = finite & jnp.isfinite(pose.heading_rad) & jnp.isfinite(pose.position_m).all(-1)
    return pings._replace(mask=pings.mask & finite)
