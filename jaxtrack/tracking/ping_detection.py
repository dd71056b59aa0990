"""From a sweep of a mechanically scanned sonar to the places of what stands in the water.

    intensities ── threshold, each ping's pose ──► cloud ── gap ──► clusters ── means ──► places

Source: Zernike moment paper (2023), figure 3; it gives no threshold and no gap.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.clustering.linkage import Clusters, linked
from jaxtrack.numerics.checks import check_positive
from jaxtrack.numerics.masked import masked_max, masked_mean
from jaxtrack.numerics.safe import safe_divide, safe_norm
from jaxtrack.sensors.ping_cloud import cloud_of_pings, sound_pings
from jaxtrack.sensors.scanning_sonar import ScanningSonar
from jaxtrack.types import Array, Pings, Scan


class PingDetection(NamedTuple):
    """What counts as a target. Traced."""

    threshold: Array | float = 4.0  # γ of a cell's intensity
    gap_m: Array | float = 0.6  # between points of one cluster, at most …
    gap_steps: Array | float = 1.5  # … or this many of the sonar's steps at their range
    members: Array | int = 3  # of a cluster, at least
    reach_m: Array | float = 1.5  # of a cluster from its centre, at most: a dike is larger


class PingDetectionInfo(NamedTuple):
    """What the places were made from."""

    cloud: Scan  # [P] the points
    clusters: Clusters  # [K] all of them, the large ones included
    overflow: Array  # [] more points or clusters than places for them


def detect_in_pings(
    pings: Pings,
    sonar: ScanningSonar,
    params: PingDetection | None = None,
    *,
    points: int = 512,
    clusters: int = 32,
) -> tuple[Scan, PingDetectionInfo]:
    """Return the centroids of the clusters in a sweep, as a look of K detections.

    Args:
        pings: Q pings of R bins, of one sweep.
        sonar: its scope and mounting.
        params: threshold, gap and sizes of targets; the defaults if None.
        points: places for points, static.
        clusters: K places for clusters, static.

    Returns:
        A scan at the time of the first live ping, the heaviest cluster first. A detection's delay
        is the mean of its points', its intensity their summed weight.

    Raises:
        ValueError: a shape that does not fit, or a known value that cannot be.
        TypeError: a mask of numbers, a size that is no int.

    Example:
        >>> import jax
        >>> from jaxtrack.sensors import dragged_bucket, IMAGENEX_881L
        >>> run = dragged_bucket(jax.random.key(0), "static", frames=1)
        >>> sweep = jax.tree.map(lambda x: x[0], run.pings)
        >>> scan, info = detect_in_pings(sweep, IMAGENEX_881L.sonar)
        >>> gap_m = jnp.linalg.norm(scan.position_m - run.truth.state[0, 0, :2], axis=-1)
        >>> print(jnp.where(scan.mask, gap_m, jnp.inf).min() < 0.5, info.overflow)
        True False

    Note:
        The centroid is that of the side that echoes: it lies before the target's middle, by about
        three quarters of a cylinder's radius.
    """
    params = PingDetection() if params is None else params
    cloud, crowded = cloud_of_pings(pings, sonar, params.threshold, points=points)
    dtype = cloud.position_m.dtype
    # A sweep's poses are all but one place, seen from where the beams stand wide apart.
    stands = sound_pings(pings).mask
    stand_m = masked_mean(pings.pose.position_m, stands[:, None], axis=0)
    beams_m = jnp.asarray(sonar.step_rad, dtype) * safe_norm(cloud.position_m - stand_m[None])
    gap_m = check_positive("params.gap_m", params.gap_m, dtype)
    found = linked(
        cloud.position_m,
        jnp.maximum(gap_m, jnp.asarray(params.gap_steps, dtype) * beams_m),
        weights=cloud.weight,
        mask=cloud.mask,
        members=params.members,
        clusters=clusters,
    )
    reach_m = check_positive("params.reach_m", params.reach_m, dtype)
    belongs = found.label[None, :] == jnp.arange(clusters, dtype=jnp.int32)[:, None]
    apart_m = safe_norm(cloud.position_m[None] - found.centre[:, None])
    mask = found.mask & (masked_max(apart_m, belongs, axis=1) <= reach_m)
    assert cloud.weight is not None
    assert cloud.delay_s is not None
    share = jnp.where(belongs, cloud.weight[None, :], 0.0)
    # Where all cells are just at the threshold they count alike, as in the centre.
    share = jnp.where((share.sum(axis=1) > 0)[:, None], share, belongs.astype(dtype))
    delay_s = safe_divide((share * cloud.delay_s[None, :]).sum(axis=1), share.sum(axis=1))
    scan = Scan(
        cloud.time_s,
        cloud.valid,
        jnp.where(mask[:, None], found.centre, 0.0),
        mask,
        delay_s=jnp.where(mask, delay_s, 0.0),
        intensity=jnp.where(mask, found.mass, 0.0),
    )
    return scan, PingDetectionInfo(cloud, found, crowded | found.overflow)
