"""The trackers of the study `csht_tracking`, with settings fixed for all cells, and its floor."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.hough import clustering_statistic, joint, pack_beams
from jaxtrack.hough.slope_intercept import LineSizes
from jaxtrack.metrics import KnownDetections, known_least_squares
from jaxtrack.models import BEAMS, BeamSonar
from jaxtrack.sensors import in_view, scan_of_beams
from jaxtrack.studies.csht.trial import BEAM_COUNT, POSITIONS, SPEED, assumed
from jaxtrack.studies.tracking.consistency import Found
from jaxtrack.tracking import (
    HoughTrackerParams,
    KalmanPaperParams,
    KalmanTrackerParams,
    LifecycleParams,
    hough_tracker,
    kalman_paper,
    kalman_tracker,
    sliding,
)
from jaxtrack.tracking.sight import on_board, sight_of
from jaxtrack.types import Array, BeamScan, Estimator, Stage, Tracks, Truth

WINDOW = 20
TRACKERS = ("hough joint", "hough CSHT", "kalman paper", "kalman LBP")
FLOOR = "delay floor"  # told which detection is whose, once the evidence is there
TO_THE_LETTER = "kalman paper, X₀ = 0"  # beside them, in one cell
KEEP, CONFIRM = 7.0, 13.0  # nats of evidence that keep a track alive, and that confirm it

_PAIRS = {"per_beam": 32768, "per_scan": 8192}
_SLOTS = 12
_KALMAN_SLOTS = 96  # clutter fills many


class Crowded(NamedTuple):
    """Where tables were too small."""

    overflow: Array  # [T] that of the joint vote's pairs
    full: Array  # [T] that of the tracks


def track(
    name: str, scans: BeamScan, sonar: BeamSonar, false_alarms: str, targets: int
) -> tuple[Found, Crowded]:
    """Return what a tracker reports at every look, and where its tables were too small.

    Only what is confirmed and in sight counts. To the joint vote and the sensible Kalman tracker a
    look out of sight is no miss; the others are the paper's, which do not ask.
    """
    tracker, looks = _tracker(name, scans, sonar, false_alarms, targets)
    _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), looks)
    tracks: Tracks = info.tracks
    seen = jax.vmap(lambda mean, pose: in_view(mean[:, :2], pose, sonar))(tracks.mean, scans.pose)
    mask = (tracks.stage >= Stage.CONFIRMED) & seen
    none = jnp.zeros(mask.shape[0], bool)
    overflow = info.info.overflow if name == "hough joint" else none
    reported = Found(tracks.mean, tracks.covariance, mask, tracks.identity)
    return reported, Crowded(overflow, info.full)


def _tracker(
    name: str, scans: BeamScan, sonar: BeamSonar, false_alarms: str, targets: int
) -> tuple[Estimator, Any]:
    """Return a tracker and the looks that it takes."""
    first = lambda looks: jax.tree.map(lambda x: x[0], looks)
    dtype = scans.time_s.dtype
    detect = 1 - jnp.asarray(sonar.p_miss, dtype)
    if name == "hough joint":
        params = joint.JointParams(assumed(sonar, false_alarms), SPEED, KEEP)
        sizes = joint.JointSizes(
            targets, _PAIRS[false_alarms], 1024, gap=3, survivors=4096, samples=256
        )
        tracker = hough_tracker(
            lambda looks: joint.estimate(looks, params, sizes=sizes, observation=BEAMS),
            HoughTrackerParams(lifecycle=LifecycleParams(1, CONFIRM, 8)),
            like=first(scans),
            window=WINDOW,
            max_tracks=_SLOTS,
            p_detect=sight_of(sonar),
        )
        return tracker, scans
    if name == "hough CSHT":
        looks, _ = pack_beams(scans, sonar, POSITIONS[false_alarms])
        paper = clustering_statistic.ClusteringParams()
        wide = clustering_statistic.ClusteringSizes(lines=LineSizes(positions=75))
        tracker = hough_tracker(
            lambda looks: clustering_statistic.estimate(looks, paper, sizes=wide),
            HoughTrackerParams(gate=60.0, lifecycle=LifecycleParams(2, delete_misses=3)),
            like=first(looks),
            window=WINDOW,
            max_tracks=_SLOTS,
        )
        return tracker, looks
    looks = jax.vmap(scan_of_beams, (0, None))(scans, sonar)
    scope, sector = (jnp.asarray(x, dtype) for x in (sonar.range_max_m, sonar.sector_rad))
    alarms = jnp.asarray(sonar.p_false, dtype) * (BEAM_COUNT if false_alarms == "per_beam" else 1)
    clutter = alarms / (scope**2 * sector / 2)
    if name in ("kalman paper", TO_THE_LETTER):
        settings = KalmanPaperParams(sonar.sigma_m, 0.5, p_detect=detect, clutter_per_m2=clutter)
        start = "origin" if name == TO_THE_LETTER else "detection"
        return kalman_paper(settings, max_tracks=_KALMAN_SLOTS, start=start), looks
    return _kalman_lbp(detect, clutter, sonar), (looks, scans.pose)


def _kalman_lbp(detect: Array, clutter: Array, sonar: BeamSonar) -> Estimator:
    """Return a Kalman tracker with settings that suit the scene, over looks with their poses.

    Its many tentative tracks are too many for exact JPDA, which belief propagation stands for.
    """
    params = KalmanTrackerParams(
        sonar.sigma_m,
        0.02,
        detect,
        clutter,
        birth_sigma_m_s=1.5,
        gate=12.0,
        lifecycle=LifecycleParams(6, 14.0, 6, 3),
    )

    return on_board(
        lambda sees: kalman_tracker(
            params,
            max_tracks=_KALMAN_SLOTS,
            associator="belief_propagation",
            confirm_looks=10,
            p_detect=sees,
        ),
        sonar,
    )


def floor(
    scans: BeamScan, origin: Array, truth: Truth, sonar: BeamSonar, false_alarms: str
) -> Found:
    """Return least squares of all detections so far, from when the evidence at the truth is there.

    No tracker of windows can know of a target before, nor know its place better after.
    """
    stack = sliding(
        lambda looks: (looks, None), like=jax.tree.map(lambda x: x[0], scans), window=WINDOW
    )
    _, windows = jax.lax.scan(stack.step, stack.init(jax.random.key(0)), scans)
    sensor = assumed(sonar, false_alarms)
    weigh = lambda state, looks: joint.evidence(
        state, looks, sensor, SPEED, samples=256, observation=BEAMS
    )[2]
    score = jax.lax.map(lambda at: jax.vmap(weigh, (0, None))(*at), (truth.state, windows.tracks))
    enough = (score >= CONFIRM) & truth.mask
    known = jax.lax.cummax(enough.astype(jnp.int32), axis=0) > 0

    targets = truth.mask.shape[1]
    own = origin[None] == jnp.arange(targets, dtype=jnp.int32)[:, None, None]  # [K, T, B]
    beam = jnp.argmax(own, axis=2).astype(jnp.int32)
    range_m = jnp.take_along_axis(scans.range_m[None], beam[..., None], axis=2)[..., 0]

    def fit(at: tuple[Array, Array]) -> tuple[Array, Array]:
        now_s, start = at
        elapsed_s = scans.time_s - now_s
        past = (elapsed_s <= 0)[None] & own.any(2)
        each = lambda range_m, beam, mask, start: known_least_squares(
            KnownDetections(elapsed_s, scans.pose, range_m, beam, mask),
            sonar,
            start,
            beams=BEAM_COUNT,
        )
        found = jax.vmap(each)(range_m, beam, past, start)
        return found.state, found.covariance

    mean, covariance = jax.lax.map(fit, (scans.time_s, truth.state))
    identity = jnp.broadcast_to(jnp.arange(targets, dtype=jnp.int32), truth.mask.shape)
    return Found(mean, covariance, known & truth.mask, identity)
