"""From the looks of a recording to tracks over time: clutter, sizes and scores come from the data.

What is asked of the user is what the data cannot tell: speeds, noise, detection probability and how
often a false track may start.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.association import ASSOCIATORS
from jaxtrack.association.jpda import MAX_TRACKS
from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.models import BeamSonar
from jaxtrack.numerics.checks import check_choice, check_known, check_size
from jaxtrack.sensors.sonar import in_view
from jaxtrack.tracking.cells import CELL_VOTES, cells_of
from jaxtrack.tracking.prepared import (
    MOST_TRACKS,
    confirming_evidence,
    joint_sizes,
    prepare,
)
from jaxtrack.tracking.track_program import PAPERS_KALMAN, Told, program
from jaxtrack.types import Array, BeamScan, Key, Scan, Stage, Tracks

_NEAR = 3.0  # detections near an estimate of the votes in cells; two fit any line

TRACKERS = ("joint", *CELL_VOTES, PAPERS_KALMAN, *ASSOCIATORS)


class TrackInfo(NamedTuple):
    """What people look at."""

    confirm_score: float  # that confirmed a track
    unit: str  # of that score: nats, or detections
    clutter_per_m2: float  # detections a square metre and look
    full: Array  # [T] a candidate found no free slot
    notes: tuple[str, ...]  # what did not fit, in sentences


def track(
    scans: Scan | BeamScan,
    *,
    tracker: str = "joint",
    sonar: BeamSonar | None = None,
    speed: SpeedGate = SpeedGate(),  # noqa: B008 - an immutable tuple
    sigma_m: float = 10.0,
    sigma_a_m_s2: float = 0.05,
    p_detect: float = 0.9,
    echoes: float = 1.0,
    false_per_window: float = 0.01,
    window: int = 10,
    max_tracks: int | None = None,
    key: Key | None = None,
) -> tuple[Tracks, TrackInfo]:
    """Return the tracks of a recording at every look, stacked [T].

    Not for `jit`: array sizes, clutter and scores depend on the values of the data.

    `"joint"` is `hough_tracker` on the joint vote over the last looks, `"csht"` and `"sht"` are it
    on the votes in cells of the clustering-statistic paper, `"kalman_paper"` is that paper's weak
    baseline; every other name is `kalman_tracker` with that associator. A track is confirmed by
    log(A/f) nats of evidence, or by log(n/f) of a Kalman tracker's score: with A the field's square
    metres, n the detections of a window and f `false_per_window`, clutter alone reaches that at
    most f times a window on average. The votes in cells have no such score: two looks with an
    estimate of three detections or more confirm a track, and clutter's tracks are among them.

    Args:
        scans: T looks stacked, as a `Recording` holds them, of positions or of a sonar's beams.
        tracker: one of `TRACKERS`.
        sonar: of looks at beams: its rates, noise and geometry, in place of `sigma_m` and
            `p_detect`. Tracks out of its sight are neither missed nor reported.
        speed: slowest and fastest target, m/s: bounds of the votes; to a Kalman tracker the fastest
            is twice the standard deviation of a new track's velocity, to `"kalman_paper"` nothing.
        sigma_m: noise of a detection, metres, where the scans have no covariances; everywhere for
            the votes in cells and `"kalman_paper"`, which do not read any.
        sigma_a_m_s2: acceleration of a target, each coordinate, m/s².
        p_detect: probability that a target is detected in a look, in (0, 1).
        echoes: mean number of detections of a detected target. PMHT reads it; the cloud models need
            no such number; every other tracker takes one detection a target and look.
        false_per_window: wanted mean number of false tracks in a window, at most.
        window: looks of the votes, and those that `false_per_window` counts.
        max_tracks: slots of the table; tentative tracks take some, in a Kalman tracker many.
            None: 32, and 10 of the votes and of `jpda`, which has no more.
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
    want = "at least one echo"
    check_known("echoes", echoes, lambda x: (x >= 1) & np.isfinite(x), want)
    if echoes > 1 and not (tracker in ASSOCIATORS and ASSOCIATORS[tracker].several):
        takes = ", ".join(name for name, one in ASSOCIATORS.items() if one.several)
        raise ValueError(f"echoes: got {echoes}, want 1 with {tracker}; several take {takes}")
    check_size("window", window, at_least=3)
    most = MAX_TRACKS if tracker == "jpda" else MOST_TRACKS
    if max_tracks is None:
        max_tracks = 10 if tracker in ("joint", *CELL_VOTES, "jpda") else 32
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
    looks, notes, sizes, cells = ready.looks, (), None, None
    between_s = _between(ready.positions)
    if tracker == "joint":
        score = confirming_evidence(ready, false_per_window)
        sizes, notes = joint_sizes(ready.positions, speed, window=window, tracks=max_tracks)
    elif tracker in CELL_VOTES:
        looks = ready.positions._replace(covariance_m2=None)
        lasts_s = (window - 1) * between_s
        cells, sizes, notes = cells_of(ready, float(speed.v_max_m_s), lasts_s, tracks=max_tracks)
        score = _NEAR
    else:
        number = max(ready.detections_per_look * window, 1.0)
        score = max(math.log(number / false_per_window), 1.0)
        looks = ready.positions
        if sonar is not None and tracker != PAPERS_KALMAN:
            looks = looks, ready.looks.pose
    told = Told(
        ready.sensor,
        sonar,
        speed,
        score,
        ready.sigma_m,
        sigma_a_m_s2,
        ready.p_detect,
        ready.clutter_per_m2,
        echoes,
        between_s,
        cells,
    )
    dtype = ready.positions.position_m.dtype
    told = jax.tree.map(lambda x: jnp.asarray(x, dtype), told)
    run = program(tracker, sizes, ready.observation, window, max_tracks)
    info = run(jax.random.key(0) if key is None else key, looks, told)
    tracks: Tracks = info.tracks
    shown = tracks.mask & (tracks.stage >= Stage.CONFIRMED)
    if sonar is not None:
        seen = jax.vmap(lambda state, pose: in_view(state[:, :2], pose, sonar))
        shown = shown & seen(tracks.mean, ready.looks.pose)
    if sizes is not None and bool(jnp.any(info.info.overflow)):
        what = "pairs of detections" if tracker == "joint" else "cells over the threshold"
        notes += (f"windows held more {what} than fit: tracks may be missing",)
    if bool(jnp.any(info.full)):
        more = "raise max_tracks" if max_tracks < most else "belief_propagation takes more"
        notes += (f"the table of {max_tracks} tracks was full at times: {more}",)
    unit = "detections" if tracker in CELL_VOTES else "nats"
    shown = tracks._replace(mask=shown)
    return shown, TrackInfo(score, unit, ready.clutter_per_m2, info.full, notes)


def _between(scans: Scan) -> float:
    """Return the median time between looks, in seconds; 1 where there is none."""
    times = np.asarray(scans.time_s, np.float64)[np.asarray(scans.valid)]
    steps = np.diff(times)
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else 1.0
