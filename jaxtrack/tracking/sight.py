"""Where a sensor sees: a look counts as a miss only for tracks that it could have shown."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from jaxtrack.models import BeamSonar
from jaxtrack.sensors.sonar import in_view
from jaxtrack.types import Array, Estimator, Pose, Scan

Detect = Callable[[Array, Any], Array]
"""(mean [S], scan) → the probability that the sensor sees a target there, in this look."""

COUNTS = 0.01
"""Probability of detection below which a look is no miss."""


def everywhere(mean: Array, scan: Any) -> Array:
    """Return 1: a sensor that sees everywhere.

    Example:
        >>> print(everywhere(jnp.zeros(4), None))
        1.0
    """
    return jnp.ones((), mean.dtype)


def sight_of(sonar: BeamSonar) -> Detect:
    """Return where a sonar sees, for looks that carry their pose: 1 within scope and sector, else 0.

    Example:
        >>> from jaxtrack.types import BeamScan
        >>> look = BeamScan(jnp.zeros(()), jnp.array(True), jnp.zeros(9), jnp.ones(9, bool),
        ...                 Pose(jnp.zeros(2), jnp.zeros(())))
        >>> print(sight_of(BeamSonar())(jnp.array([80.0, 90.0, 0.0, 0.0]), look))
        0.0
    """  # noqa: E501
    return lambda mean, scan: in_view(mean[:2], scan.pose, sonar).astype(mean.dtype)


def on_board(build: Callable[[Detect | None], Estimator], sonar: BeamSonar) -> Estimator:
    """Return a tracker of positions over (look, pose of the sonar's carrier) instead of looks.

    Args:
        build: makes the tracker from where the sensor sees.
        sonar: whose scope and sector count.

    Example:
        >>> from jaxtrack.tracking import KalmanTrackerParams, kalman_tracker
        >>> params = KalmanTrackerParams(1.0, 0.1, 0.9, 1e-4)
        >>> tracker = on_board(
        ...     lambda sees: kalman_tracker(params, max_tracks=2, p_detect=sees), BeamSonar())
        >>> look = Scan(jnp.zeros(()), jnp.array(True), jnp.ones((1, 2)), jnp.ones(1, bool))
        >>> import jax
        >>> at = look, Pose(jnp.zeros(2), jnp.zeros(()))
        >>> print(tracker.step(tracker.init(jax.random.key(0)), at)[1].tracks.mask)
        [ True False]
    """

    def step(state: Any, at: tuple[Scan, Pose]) -> tuple[Any, Any]:
        look, pose = at
        sees = lambda mean, _: in_view(mean[:2], pose, sonar).astype(mean.dtype)
        return build(sees).step(state, look)

    return Estimator(build(None).init, step)
