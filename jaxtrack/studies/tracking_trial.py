"""One trial of the study `csht_tracking`: targets come and go, all trackers see the same looks.

Scene and rates are traced: every cell of every table is the same compiled program. The false-alarm
model is static, and so are the trackers' settings, fixed for all cells.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.hough import clustering_statistic, joint, pack_beams
from jaxtrack.hough.slope_intercept import LineSizes
from jaxtrack.metrics import KnownDetections, known_least_squares, ospa
from jaxtrack.models import BEAMS, BeamSonar
from jaxtrack.sensors import (
    SonarScene,
    SonarSceneLimits,
    in_sight,
    in_view,
    observe_known_beams,
    random_sonar_scene,
    scan_of_beams,
)
from jaxtrack.studies.csht_trial import (
    BEAM_COUNT,
    CUTOFF,
    ORDER,
    POSITIONS,
    SPEED,
    assumed,
)
from jaxtrack.studies.tracking_consistency import Consistency, Found, consistency_of
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
from jaxtrack.types import Array, BeamScan, Estimator, Key, Stage, Tracks, Truth

WINDOW = 20
TRACKERS = ("hough joint", "hough CSHT", "kalman paper", "kalman LBP")
FLOOR = "delay floor"  # told which detection is whose, once the evidence is there
TRUTHS = ("visible", "table")
TO_THE_LETTER = "kalman paper, X₀ = 0"  # beside them, in one cell
KEEP, CONFIRM = 7.0, 13.0  # nats of evidence that keep a track alive, and that confirm it

_PAIRS = {"per_beam": 32768, "per_scan": 8192}
_SLOTS = 12
_SETTLED_S = 10.0
_KALMAN_SLOTS = 96  # clutter fills many


class Inputs(NamedTuple):
    """What one program is run with. Traced."""

    scene: SonarScene  # its truth: that of the table
    visible: Truth  # while the sonar can see the targets


class Scores(NamedTuple):
    """How far one tracker is from one truth, look by look, metres."""

    distance: Array  # [T] OSPA
    localization: Array  # [T]
    cardinality: Array  # [T]


class Outcome(NamedTuple):
    """What one trial gives."""

    scores: dict[str, dict[str, Scores]]  # by truth and tracker
    consistency: dict[str, Consistency]  # by tracker
    overflow: Array  # [T] tables of the joint vote were too small
    full: dict[str, Array]  # [T] by tracker: its table turned somebody away
    quiet: Array  # [T] no birth or death in the last ten seconds


class Crowded(NamedTuple):
    """Where tables were too small."""

    overflow: Array  # [T] that of the joint vote's pairs
    full: Array  # [T] that of the tracks


@functools.cache
def trial(false_alarms: str, *, targets: int = 6) -> Callable[[Key, Inputs], Outcome]:
    """Return the function of one trial, the same object for the same model of false alarms.

    Args:
        false_alarms: `"per_beam"` or `"per_scan"`.
        targets: that the joint vote looks for in a window.
    """

    def run(key: Key, inputs: Inputs) -> Outcome:
        scene, visible = inputs
        scans, origin = observe_known_beams(
            key, *scene, beams=BEAM_COUNT, false_alarms=false_alarms
        )
        found, full, overflow = {}, {}, jnp.zeros(scans.time_s.shape, bool)
        for name in TRACKERS:
            found[name], crowded = track(name, scans, scene.sonar, false_alarms, targets)
            overflow, full[name] = overflow | crowded.overflow, crowded.full
        found[FLOOR] = _floor(scans, origin, visible, scene.sonar, false_alarms)
        truths = {"visible": visible, "table": scene.truth}
        scores = {
            which: {name: scores_of(tracks, truth) for name, tracks in found.items()}
            for which, truth in truths.items()
        }
        agreed = {name: consistency_of(tracks, visible) for name, tracks in found.items()}
        full[FLOOR] = jnp.zeros_like(overflow)
        return Outcome(scores, agreed, overflow, full, quiet_looks(visible))

    return run


def generated_trial(key: Key, inputs: BeamSonar) -> Outcome:
    """Return one trial on a scene of its own: one to eight targets that come, cross and go."""
    draw, number, spans, look = jax.random.split(key, 4)
    targets, looks = 8, 120
    scene, _ = random_sonar_scene(
        draw,
        inputs,
        SonarSceneLimits(seen_share=0.3),
        targets=targets,
        count=jax.random.randint(number, (), 1, targets + 1),
        looks=looks,
        beams=BEAM_COUNT,
    )
    share = jax.random.uniform(spans, (2, targets), scene.truth.state.dtype)
    born, gone = looks * share[0] / 2, looks * (0.5 + share[1])
    step = jnp.arange(looks)[:, None]
    there = scene.truth.mask & (step >= born[None]) & (step < gone[None])
    truth = in_sight(scene.truth._replace(mask=there), scene.pose, inputs)
    return trial("per_beam", targets=9)(look, Inputs(scene._replace(truth=truth), truth))


def quiet_looks(truth: Truth) -> Array:
    """Return which looks have no birth or death in the last ten seconds, [T].

    Args:
        truth: T looks; what is there at the first is born then.
    """
    before = jnp.concatenate([jnp.zeros_like(truth.mask[:1]), truth.mask[:-1]])
    changed = (truth.mask != before).any(1)
    ago_s = truth.time_s[:, None] - truth.time_s[None, :]
    recent = (ago_s >= 0) & (ago_s < _SETTLED_S)
    return ~(recent & changed[None, :]).any(1)


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


def _floor(
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
    own = origin[None] == jnp.arange(targets)[:, None, None]  # [K, T, B]
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


def scores_of(found: Found, truth: Truth) -> Scores:
    """Return how far what is reported is from what is true, look by look."""
    each = jax.vmap(
        lambda mean, mask, state, there: ospa(
            mean[:, :2], mask, state[:, :2], there, cutoff=CUTOFF, order=ORDER
        )
    )
    return Scores(*each(found.mean, found.mask, truth.state, truth.mask))
