"""From one window of a recording to its targets' motion elements: where they were, are and go."""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.hough import joint
from jaxtrack.hough.clustering_params import ClusteringSizes
from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.models import BeamSonar
from jaxtrack.models.motion import look_times, propagate
from jaxtrack.models.observation import Observation
from jaxtrack.numerics.checks import check_choice, check_size
from jaxtrack.tracking.cells import CELL_VOTES, cells_of
from jaxtrack.tracking.prepared import (
    MOST_TRACKS,
    Prepared,
    confirming_evidence,
    joint_sizes,
    prepare,
)
from jaxtrack.types import Array, BeamScan, Scan, Stage, Tracks

ESTIMATORS = ("joint", *CELL_VOTES)


class MotionElements(NamedTuple):
    """The targets of a window; the tables have M places."""

    tracks: Tracks  # at the window's last look
    initial: Array  # [M, 4] x, y, vx, vy at its first
    gate: float  # that a joint track's evidence had to reach; nan of the others
    notes: tuple[str, ...]  # what did not fit, in sentences


def motion_elements(
    scans: Scan | BeamScan,
    *,
    method: str = "joint",
    sonar: BeamSonar | None = None,
    speed: SpeedGate = SpeedGate(),  # noqa: B008 - an immutable tuple
    sigma_m: float = 10.0,
    p_detect: float = 0.9,
    false_per_window: float = 0.01,
    max_tracks: int = 8,
) -> MotionElements:
    """Return initial and current positions and velocities of the targets in a recording's looks.

    Not for `jit`: array sizes, grids and the gate depend on the values of the data.

    Args:
        scans: K looks stacked, as a `Recording` holds them; all are one window.
        method: `"joint"`, the joint vote; `"csht"`, the clustering-statistic Hough transform, or
            `"sht"`, all its cells above the threshold. The two see positions, in cells of 2.2 σ.
        sonar: of looks at beams: its rates, noise and geometry, in place of `sigma_m` and
            `p_detect`.
        speed: slowest and fastest target, m/s; of the votes in cells only the fastest counts.
        sigma_m: noise of a detection, metres.
        p_detect: probability that a target is detected in a look, in (0, 1).
        false_per_window: wanted mean number of false tracks, at most; of the joint vote.
        max_tracks: that are looked for.

    Raises:
        ValueError: an option is out of range, a position is not finite, times run back, or there
            are fewer than two looks.

    Example:
        >>> t = np.arange(8.0)
        >>> at = np.stack([90 + 30 * t, 500 - 20 * t], axis=-1)[:, None]
        >>> scans = Scan(t, np.ones(8, bool), at, np.ones((8, 1), bool))
        >>> found = motion_elements(scans, speed=SpeedGate(0.0, 60.0), sigma_m=5.0, max_tracks=2)
        >>> print(found.initial[0].round(), found.tracks.mean[0].round())
        [ 90. 500.  30. -20.] [300. 360.  30. -20.]
    """
    check_choice("method", method, ESTIMATORS)
    if check_size("max_tracks", max_tracks) > MOST_TRACKS:
        raise ValueError(f"max_tracks: got {max_tracks}, want at most {MOST_TRACKS}")
    ready = prepare(
        scans,
        sonar,
        speed,
        sigma_m=sigma_m,
        p_detect=p_detect,
        false_per_window=false_per_window,
    )
    valid = np.flatnonzero(np.asarray(ready.looks.valid))
    check_size("number of valid looks", len(valid), at_least=2)
    if method != "joint":
        return _by_cells(ready, method, speed, max_tracks)
    window = len(valid)
    gate = confirming_evidence(ready, false_per_window)
    sizes, notes = joint_sizes(ready.positions, speed, window=window, tracks=max_tracks)
    looks = jax.tree.map(lambda x: x[valid], ready.looks)
    voted = joint.JointParams(ready.sensor, speed, gate)
    voted = jax.tree.map(lambda x: jnp.asarray(x, looks.time_s.dtype), voted)
    tracks, info = _joint_program(sizes, ready.observation)(looks, voted)
    if bool(info.overflow):
        notes += ("there are more pairs of detections than fit: targets may be missing",)
    # Their evidence has passed the gate, which is what confirms a track.
    stage = jnp.where(tracks.mask, Stage.CONFIRMED, Stage.EMPTY).astype(tracks.stage.dtype)
    tracks = tracks._replace(stage=stage)
    start_s, _ = look_times(looks)
    return MotionElements(tracks, propagate(tracks.mean, start_s[0]), gate, notes)


def _by_cells(ready: Prepared, method: str, speed: SpeedGate, max_tracks: int) -> MotionElements:
    """Return what the vote in cells of velocity and initial position finds."""
    scans = ready.positions._replace(covariance_m2=None)
    times = np.asarray(scans.time_s, np.float64)[np.asarray(scans.valid)]
    fastest = float(speed.v_max_m_s)
    params, sizes, notes = cells_of(ready, fastest, float(np.ptp(times)), tracks=max_tracks)
    params = jax.tree.map(lambda x: jnp.asarray(x, scans.position_m.dtype), params)
    tracks, info = _cells_program(method, sizes)(scans, params)
    mask, bare = np.asarray(tracks.mask), np.asarray(tracks.log_score) == 0
    if (mask & bare).any():
        notes += (f"left out, as no detection is near: {(mask & bare).sum()} targets",)
        tracks = tracks._replace(mask=tracks.mask & ~bare)
    if bool(jnp.any(info.overflow)):
        notes += ("more cells passed the threshold than fit: targets may be missing",)
    return MotionElements(tracks, info.initial, math.nan, notes)


@functools.lru_cache(maxsize=16)
def _joint_program(sizes: joint.JointSizes, observation: Observation) -> Callable[..., Any]:
    return jax.jit(functools.partial(joint.estimate, sizes=sizes, observation=observation))


@functools.lru_cache(maxsize=16)
def _cells_program(method: str, sizes: ClusteringSizes) -> Callable[..., Any]:
    return jax.jit(functools.partial(CELL_VOTES[method], sizes=sizes))
