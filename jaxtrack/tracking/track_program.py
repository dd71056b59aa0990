"""The trackers that `track` offers, each a whole run over a recording, compiled once."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.hough import joint
from jaxtrack.hough.clustering_params import ClusteringSizes
from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.models import BeamSonar
from jaxtrack.models.observation import Observation
from jaxtrack.tracking.cells import CELL_VOTES
from jaxtrack.tracking.hough_tracker import HoughTrackerParams, hough_tracker
from jaxtrack.tracking.kalman_paper import KalmanPaperParams, kalman_paper
from jaxtrack.tracking.kalman_tracker import KalmanTrackerParams, kalman_tracker
from jaxtrack.tracking.lifecycle import LifecycleParams
from jaxtrack.tracking.sight import on_board, sight_of
from jaxtrack.types import Estimator, Key, Scan

PAPERS_KALMAN = "kalman_paper"

_KEEP = 4.0  # nats below the confirming score at which the joint vote still holds a track


class Told(NamedTuple):
    """What a tracker is told of sensor and targets. Traced."""

    sensor: Any
    sonar: BeamSonar | None
    speed: SpeedGate
    score: Any
    sigma_m: Any
    sigma_a_m_s2: Any
    p_detect: Any
    clutter_per_m2: Any
    echoes: Any
    dt_s: Any  # between looks
    cells: Any  # of the votes in cells: their `ClusteringParams`


@functools.lru_cache(maxsize=16)
def program(
    tracker: str,
    sizes: joint.JointSizes | ClusteringSizes | None,
    observation: Observation,
    window: int,
    max_tracks: int,
) -> Callable[[Key, Any, Told], Any]:
    """Return the whole run, compiled; recordings alike share it, whatever their numbers are.

    Args:
        tracker: a name in `TRACKERS`.
        sizes: of a tracker on windows; else None.
        observation: of the joint vote.
        window: looks.
        max_tracks: slots of the table.

    Example:
        >>> from jaxtrack.models import POSITION
        >>> alike = "greedy", None, POSITION, 10, 32
        >>> program(*alike) is program(*alike)
        True
    """

    def run(key: Key, looks: Any, told: Told) -> Any:
        if isinstance(sizes, joint.JointSizes):
            estimator = _joint(looks, sizes, observation, window, max_tracks, told)
        elif isinstance(sizes, ClusteringSizes):
            estimator = _in_cells(looks, sizes, tracker, window, max_tracks, told)
        elif tracker == PAPERS_KALMAN:
            estimator = _papers_kalman(max_tracks, told)
        else:
            estimator = _kalman(tracker, max_tracks, told)
        return jax.lax.scan(estimator.step, estimator.init(key), looks)[1]

    return jax.jit(run)


def _joint(
    looks: Any,
    sizes: joint.JointSizes,
    observation: Observation,
    window: int,
    max_tracks: int,
    told: Told,
) -> Estimator:
    keep = jnp.maximum(told.score - _KEEP, 0.5)
    voted = joint.JointParams(told.sensor, told.speed, keep)
    return hough_tracker(
        lambda looks: joint.estimate(looks, voted, sizes=sizes, observation=observation),
        HoughTrackerParams(told.sigma_a_m_s2, lifecycle=LifecycleParams(1, told.score, 8)),
        like=jax.tree.map(lambda x: x[0], looks),
        window=window,
        max_tracks=max_tracks,
        p_detect=None if told.sonar is None else sight_of(told.sonar),
    )


def _in_cells(
    looks: Scan, sizes: ClusteringSizes, name: str, window: int, max_tracks: int, told: Told
) -> Estimator:
    """Return a tracker on the vote in cells; what no detection is near is no estimate."""

    def estimate(looks: Scan) -> Any:
        tracks, info = CELL_VOTES[name](looks, told.cells, sizes=sizes)
        return tracks._replace(mask=tracks.mask & (tracks.log_score > 0)), info

    return hough_tracker(
        estimate,
        HoughTrackerParams(
            told.sigma_a_m_s2, gate=60.0, lifecycle=LifecycleParams(2, told.score, 3)
        ),
        like=jax.tree.map(lambda x: x[0], looks),
        window=window,
        max_tracks=max_tracks,
    )


def _papers_kalman(max_tracks: int, told: Told) -> Estimator:
    params = KalmanPaperParams(
        told.sigma_m,
        told.dt_s,
        p_detect=told.p_detect,
        clutter_per_m2=told.clutter_per_m2,
        lifecycle=LifecycleParams(3, told.score),
    )
    return kalman_paper(params, max_tracks=max_tracks)


def _kalman(tracker: str, max_tracks: int, told: Told) -> Estimator:
    """Return a Kalman tracker, over looks, or over looks with the poses of a sonar."""
    params = KalmanTrackerParams(
        told.sigma_m,
        told.sigma_a_m_s2,
        told.p_detect,
        told.clutter_per_m2,
        birth_sigma_m_s=told.speed.v_max_m_s / 2,
        echoes=told.echoes,
        lifecycle=LifecycleParams(3, told.score),
    )
    build = lambda sees: kalman_tracker(
        params, max_tracks=max_tracks, associator=tracker, p_detect=sees
    )
    return build(None) if told.sonar is None else on_board(build, told.sonar)
