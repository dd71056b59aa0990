"""From the looks of a recording to tracks over time: clutter, sizes and scores come from the data.

What is asked of the user is what the data cannot tell: speeds, noise, detection probability and how
often a false track may start.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.association import ASSOCIATORS
from jaxtrack.association.jpda import MAX_TRACKS
from jaxtrack.hough import joint
from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.models import BeamSonar
from jaxtrack.models.observation import Observation
from jaxtrack.numerics.checks import check_choice, check_known, check_size
from jaxtrack.sensors.sonar import in_view
from jaxtrack.tracking.hough_tracker import HoughTrackerParams, hough_tracker
from jaxtrack.tracking.kalman_tracker import KalmanTrackerParams, kalman_tracker
from jaxtrack.tracking.lifecycle import LifecycleParams
from jaxtrack.tracking.prepared import (
    MOST_TRACKS,
    confirming_evidence,
    joint_sizes,
    prepare,
)
from jaxtrack.tracking.sight import on_board, sight_of
from jaxtrack.types import Array, BeamScan, Estimator, Key, Scan, Stage, Tracks

TRACKERS = ("joint", *ASSOCIATORS)

_KEEP = 4.0  # nats below the confirming score at which the joint vote still holds a track


class TrackInfo(NamedTuple):
    """What people look at."""

    confirm_score: float  # nats that confirmed a track
    clutter_per_m2: float  # detections a square metre and look
    full: Array  # [T] a candidate found no free slot
    notes: tuple[str, ...]  # what did not fit, in sentences


class _Told(NamedTuple):
    """What a tracker is told of sensor and targets. Traced."""

    sensor: Any
    sonar: BeamSonar | None
    speed: SpeedGate
    score: Any
    sigma_m: Any
    sigma_a_m_s2: Any
    p_detect: Any
    clutter_per_m2: Any


def track(
    scans: Scan | BeamScan,
    *,
    tracker: str = "joint",
    sonar: BeamSonar | None = None,
    speed: SpeedGate = SpeedGate(),  # noqa: B008 - an immutable tuple
    sigma_m: float = 10.0,
    sigma_a_m_s2: float = 0.05,
    p_detect: float = 0.9,
    false_per_window: float = 0.01,
    window: int = 10,
    max_tracks: int | None = None,
    key: Key | None = None,
) -> tuple[Tracks, TrackInfo]:
    """Return the tracks of a recording at every look, stacked [T].

    Not for `jit`: array sizes, clutter and scores depend on the values of the data.

    `"joint"` is `hough_tracker` on the joint vote over the last looks; every other name is
    `kalman_tracker` with that associator. A track is confirmed by log(A/f) nats of evidence, or by
    log(n/f) of a Kalman tracker's score: with A the field's square metres, n the detections of a
    window and f `false_per_window`, clutter alone reaches that at most f times a window on average.

    Args:
        scans: T looks stacked, as a `Recording` holds them, of positions or of a sonar's beams.
        tracker: one of `TRACKERS`.
        sonar: of looks at beams: its rates, noise and geometry, in place of `sigma_m` and
            `p_detect`. Tracks out of its sight are neither missed nor reported.
        speed: slowest and fastest target, m/s.
        sigma_m: noise of a detection, metres, where the scans have no covariances.
        sigma_a_m_s2: acceleration of a target, each coordinate, m/s².
        p_detect: probability that a target is detected in a look, in (0, 1).
        false_per_window: wanted mean number of false tracks in a window, at most.
        window: looks of the joint vote, and those that `false_per_window` counts.
        max_tracks: slots of the table; tentative tracks take some, in a Kalman tracker many.
            None: 32, and 10 of `joint` and of `jpda`, which has no more.
        key: of the associators that draw; None: `jax.random.key(0)`.

    Returns:
        Tables of confirmed tracks, and what people look at.

    Raises:
        ValueError: an option is out of range, a position is not finite, or times run back.

    Example:
        >>> t = np.arange(12.0)
        >>> at = np.stack([30 * t, 500 - 20 * t], axis=-1)[:, None]
        >>> scans = Scan(t, np.ones(12, bool), at, np.ones((12, 1), bool))
        >>> tracks, info = track(scans, tracker="optimal", speed=SpeedGate(0.0, 60.0), sigma_m=5.0)
        >>> print(tracks.mean[-1, 0].round(), tracks.mask[:, 0].sum() > 6)
        [330. 280.  30. -20.] True

    Note:
        Targets' own detections count as clutter, and clutter as even over the bounding box of all
        detections. That bound on false tracks is one-sided: fewer start.
    """
    check_choice("tracker", tracker, TRACKERS)
    want = "an acceleration of at least 0 m/s²"
    check_known("sigma_a_m_s2", sigma_a_m_s2, lambda x: (x >= 0) & np.isfinite(x), want)
    check_size("window", window, at_least=3)
    most = MAX_TRACKS if tracker == "jpda" else MOST_TRACKS
    if max_tracks is None:
        max_tracks = 10 if tracker in ("joint", "jpda") else 32
    if check_size("max_tracks", max_tracks) > most:
        why = "; belief_propagation takes more" if tracker == "jpda" else ""
        raise ValueError(f"max_tracks: got {max_tracks}, want at most {most}{why}")
    ready = prepare(
        scans,
        sonar,
        speed,
        sigma_m=sigma_m,
        p_detect=p_detect,
        false_per_window=false_per_window,
    )
    looks, notes, sizes = ready.looks, (), None
    if tracker == "joint":
        score = confirming_evidence(ready, false_per_window)
        sizes, notes = joint_sizes(ready.positions, speed, window=window, tracks=max_tracks)
    else:
        number = max(ready.detections_per_look * window, 1.0)
        score = max(math.log(number / false_per_window), 1.0)
        looks = ready.positions if sonar is None else (ready.positions, looks.pose)
    told = _Told(
        ready.sensor,
        sonar,
        speed,
        score,
        ready.sigma_m,
        sigma_a_m_s2,
        ready.p_detect,
        ready.clutter_per_m2,
    )
    dtype = ready.positions.position_m.dtype
    told = jax.tree.map(lambda x: jnp.asarray(x, dtype), told)
    run = _program(tracker, sizes, ready.observation, window, max_tracks)
    info = run(jax.random.key(0) if key is None else key, looks, told)
    tracks: Tracks = info.tracks
    shown = tracks.mask & (tracks.stage >= Stage.CONFIRMED)
    if sonar is not None:
        seen = jax.vmap(lambda state, pose: in_view(state[:, :2], pose, sonar))
        shown = shown & seen(tracks.mean, ready.looks.pose)
    if tracker == "joint" and bool(jnp.any(info.info.overflow)):
        notes += ("windows held more pairs of detections than fit: tracks may be missing",)
    if bool(jnp.any(info.full)):
        more = "raise max_tracks" if max_tracks < most else "belief_propagation takes more"
        notes += (f"the table of {max_tracks} tracks was full at times: {more}",)
    return tracks._replace(mask=shown), TrackInfo(score, ready.clutter_per_m2, info.full, notes)


@functools.lru_cache(maxsize=16)
def _program(
    tracker: str,
    sizes: joint.JointSizes | None,
    observation: Observation,
    window: int,
    max_tracks: int,
) -> Callable[[Key, Any, _Told], Any]:
    """Return the whole run, compiled; recordings alike share it, whatever their numbers are."""

    def run(key: Key, looks: Any, told: _Told) -> Any:
        if sizes is None:
            estimator = _kalman(tracker, max_tracks, told)
        else:
            estimator = _joint(looks, sizes, observation, window, max_tracks, told)
        return jax.lax.scan(estimator.step, estimator.init(key), looks)[1]

    return jax.jit(run)


def _joint(
    looks: Any,
    sizes: joint.JointSizes,
    observation: Observation,
    window: int,
    max_tracks: int,
    told: _Told,
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


def _kalman(tracker: str, max_tracks: int, told: _Told) -> Estimator:
    """Return a Kalman tracker, over looks, or over looks with the poses of a sonar."""
    params = KalmanTrackerParams(
        told.sigma_m,
        told.sigma_a_m_s2,
        told.p_detect,
        told.clutter_per_m2,
        birth_sigma_m_s=told.speed.v_max_m_s / 2,
        lifecycle=LifecycleParams(3, told.score),
    )
    build = lambda sees: kalman_tracker(
        params, max_tracks=max_tracks, associator=tracker, p_detect=sees
    )
    return build(None) if told.sonar is None else on_board(build, told.sonar)
