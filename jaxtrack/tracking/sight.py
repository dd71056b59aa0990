"""Where a sensor sees: a look counts as a miss only for tracks that it could have shown."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack.filtering.gaussian import Moments
from jaxtrack.models import BeamSonar
from jaxtrack.numerics.checks import check_array
from jaxtrack.numerics.safe import safe_sqrt
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


def share_in_sight(sees: Detect, tracks: Moments, scan: Any) -> Array:
    """Return what is seen of each track on the average over where it may be, [T].

    Five points have the place's mean and covariance. At the edge of the sight a track whose mean
    lies beyond it may still be seen, and its detections are its own.

    Args:
        sees: the probability of a detection at a place.
        tracks: [T] states and covariances, positions first.
        scan: the look.

    Raises:
        ValueError: `sees` returns no single number.

    Example:
        >>> edge = lambda mean, scan: (mean[0] < 10.0).astype(mean.dtype)
        >>> tracks = Moments(jnp.array([[9.0, 0.0], [10.5, 0.0], [30.0, 0.0]]),
        ...                  jnp.stack([jnp.eye(2)] * 3))
        >>> print(share_in_sight(edge, tracks, None).round(2))
        [0.83 0.17 0.  ]
    """
    mean, covariance = tracks
    # Where the points stand is no matter of gradients.
    place = jax.lax.stop_gradient(covariance[:, :2, :2])
    a = safe_sqrt(place[:, 0, 0])
    b = place[:, 0, 1] / jnp.where(a > 0, a, 1.0)
    c = safe_sqrt(place[:, 1, 1] - b**2)
    zero = jnp.zeros_like(a)
    aside = math.sqrt(3.0) * jnp.stack([jnp.stack([a, b], -1), jnp.stack([zero, c], -1)])
    offsets = jnp.concatenate([jnp.zeros_like(aside[:1]), aside, -aside])  # [5, T, 2]

    def one(mean: Array, offset: Array) -> Array:
        seen = sees(mean.at[:2].add(offset), scan)
        check_array("p_detect(mean, scan)", seen, shape=())
        return jnp.asarray(seen, mean.dtype)

    seen = jax.vmap(jax.vmap(one), (None, 0))(mean, offsets)
    seen = jnp.where(seen > 0, jnp.where(seen < 1, seen, 1.0), 0.0)  # NaN sees nothing
    return jnp.asarray([1 / 3, 1 / 6, 1 / 6, 1 / 6, 1 / 6], mean.dtype) @ seen


def check_sight(sees: Detect | None) -> Detect:
    """Return where a sensor sees; None: everywhere.

    Raises:
        TypeError: it is no function.

    Example:
        >>> check_sight(None) is everywhere
        True
    """
    if sees is not None and not callable(sees):
        got = type(sees).__name__
        raise TypeError(f"p_detect: got {got}, want a function of (mean, scan), or None")
    return everywhere if sees is None else sees


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
