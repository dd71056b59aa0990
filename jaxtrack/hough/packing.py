"""Detections in fewer places: most beams of a sonar are silent, and empty places cost time too."""

import jax
import jax.numpy as jnp

from jaxtrack.hough.pairs import counting
from jaxtrack.models.sonar import BeamSonar
from jaxtrack.sensors.sonar import scan_of_beams
from jaxtrack.types import Array, BeamScan, Scan


def pack_detections(scans: Scan, detections: int | None) -> tuple[Scan, Array]:
    """Return scans with their detections, in order, at the front of fewer places a look.

    Args:
        scans: K looks stacked; a detection of weight 0 counts as none.
        detections: places a look; None, or no fewer than there are: the scans as they are.

    Returns:
        The scans, and whether some look had more detections than fit.

    Example:
        >>> scans = Scan(jnp.zeros(1), jnp.ones(1, bool), jnp.array([[[1.0, 1.0], [2.0, 3.0]]]),
        ...              jnp.array([[False, True]]))
        >>> packed, crowded = pack_detections(scans, 1)
        >>> print(packed.position_m[0], crowded)
        [[2. 3.]] False
    """
    counts = counting(scans)
    if detections is None or detections >= counts.shape[1]:
        return scans, jnp.asarray(False)
    order = jnp.argsort(~counts, axis=1, stable=True)[:, :detections]
    take = lambda x: None if x is None else jax.vmap(lambda row, i: row[i])(x, order)
    packed = scans._replace(
        position_m=take(scans.position_m),
        mask=take(counts),
        covariance_m2=take(scans.covariance_m2),
        weight=take(scans.weight),
        delay_s=take(scans.delay_s),
        intensity=take(scans.intensity),
    )
    return packed, (counts.sum(-1) > detections).any()


def pack_beams(scans: BeamScan, sonar: BeamSonar, detections: int) -> tuple[Scan, Array]:
    """Return a multi-beam sonar's looks as positions in fewer places, all of them alike.

    Without covariances: a vote of positions takes them as they are.

    Args:
        scans: K looks stacked.
        sonar: its sector and mounting.
        detections: places a look.

    Returns:
        The positions in the earth frame, and whether some look had more detections than fit.

    Example:
        >>> from jaxtrack.types import Pose
        >>> scans = BeamScan(jnp.zeros(1), jnp.ones(1, bool), jnp.full((1, 9), 50.0),
        ...                  jnp.arange(9)[None] == 4, Pose(jnp.zeros((1, 2)), jnp.zeros(1)))
        >>> packed, crowded = pack_beams(scans, BeamSonar(), 2)
        >>> print(packed.position_m[0, 0], packed.mask[0], crowded)
        [50.  0.] [ True False] False
    """
    positions = jax.vmap(scan_of_beams, (0, None))(scans, sonar)
    return pack_detections(positions._replace(covariance_m2=None), detections)
