"""One trial of the study `csht_estimation`: a window is simulated once, and all see the same looks.

The scene, the sonar's rates and the gate are traced: every cell of every table is the same compiled
program. Only the false-alarm model is static. Files of studies name the parts: the scene `window`,
the methods `sht`, `csht`, `joint_vote`, `floor` and `least_squares`, and the metrics.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.hough import SpeedGate, clustering_statistic, joint, pack_beams
from jaxtrack.hough.slope_intercept import cell_centres, hard_votes, points_of
from jaxtrack.metrics import (
    KnownDetections,
    all_pass_at_truth,
    known_least_squares,
    known_posterior_mean,
    ospa,
)
from jaxtrack.models import BEAMS, BeamSensor, BeamSonar
from jaxtrack.sensors import (
    SonarScene,
    motion_elements_scene,
    observe_beams,
    observe_known_beams,
)
from jaxtrack.studies.csht.cells import VARIANTS, Rates, shipped_gate, sonar_of
from jaxtrack.types import Array, BeamScan, Key, Scan, Tracks

BEAM_COUNT = 90
CUTOFF = 20.0  # metres, and metres a second
ORDER = 2.0
SPEED = SpeedGate(0.0, 6.0)  # what estimators and floor assume of a target's speed
METHODS = ("SHT", "CSHT", "joint")
KNOWN = ("floor", "least squares")  # they are told which detection is whose

# The paper's one-coordinate vote sees positions; these places hold all that a look can have.
POSITIONS = {"per_beam": 90, "per_scan": 8}
_SIZES = {
    "per_beam": joint.JointSizes(5, 16384, gap=10, survivors=4096, samples=256),
    "per_scan": joint.JointSizes(5, 4096, gap=10, samples=256),
}


class Inputs(NamedTuple):
    """What one program is run with. Traced."""

    scene: SonarScene
    gate: Array | float  # of the joint vote


class Window(NamedTuple):
    """What one trial simulates."""

    inputs: Inputs
    scans: BeamScan
    positions: Scan  # the same, as the paper's votes take them
    origin: Array  # [T, B] the target of a detection, −1 of clutter
    draw: Key  # of the floor
    false_alarms: str  # known to Python


class Estimates(NamedTuple):
    """What metrics take; of `Tracks` they read these too."""

    mean: Array  # [M, 4]
    mask: Array  # [M]


class Errors(NamedTuple):
    """How far one set of estimates is from the truth at the window's end."""

    velocity_m_s: Array  # OSPA
    position_m: Array  # OSPA
    count: Array  # estimates


class Outcome(NamedTuple):
    """What one trial gives."""

    errors: dict[str, Errors]  # by method, floor and reference
    targets: Array  # that there are
    passes_at_truth: Array  # the evidence found from every target's true path passes the gate
    overflow: Array  # a table of the joint vote was too small
    effective_samples: Array  # of the floor's posterior mean, the fewest of all targets
    within: Array  # the scene keeps to the limits of random scenes


@functools.cache
def trial(false_alarms: str) -> Callable[[Key, Inputs], Outcome]:
    """Return the function of one trial, the same object for the same model of false alarms."""

    def run(key: Key, inputs: Inputs) -> Outcome:
        seen = look(key, inputs, false_alarms)
        scene, gate = inputs
        tracks, info = _joint(seen.scans, scene.sonar, gate, false_alarms)
        truth, there = scene.truth.state[-1], scene.truth.mask[-1]
        means = _posterior_means(seen)
        estimates = {
            "SHT": sht(seen),
            "CSHT": csht(seen),
            "joint": tracks,
            "floor": Estimates(means.state, there),
            "least squares": least_squares(seen),
        }
        errors = {
            name: Errors(velocity_ospa_m_s(seen, x), position_ospa_m(seen, x), x.mask.sum())
            for name, x in estimates.items()
        }
        sensor = assumed(scene.sonar, false_alarms)
        samples = _SIZES[false_alarms].samples
        score = jax.vmap(
            lambda x: joint.evidence(
                x, seen.scans, sensor, SPEED, samples=samples, observation=BEAMS
            )[2]
        )(truth)
        passes = all_pass_at_truth(score, there, gate)
        effective = jnp.where(there, means.effective_samples, jnp.inf).min()
        return Outcome(
            errors, there.sum(), passes, info.overflow, effective, within=jnp.asarray(True)
        )

    return run


def look(key: Key, inputs: Inputs, false_alarms: str) -> Window:
    """Return the looks of one trial."""
    seen, draw = jax.random.split(key)
    scans, origin = observe_known_beams(
        seen, *inputs.scene, beams=BEAM_COUNT, false_alarms=false_alarms
    )
    positions, _ = pack_beams(scans, inputs.scene.sonar, POSITIONS[false_alarms])
    return Window(inputs, scans, positions, origin, draw, false_alarms)


def window(
    key: Key,
    *,
    false_alarms: str = "literal",
    p_miss: Any = 0.3,
    p_false: Any = 0.3,
    sigma_m: Any = 3.0,
) -> Window:
    """Return looks at the paper's three targets, and the joint vote's gate for such.

    Args:
        key: random key.
        false_alarms: one of `csht.cells.VARIANTS`, static.
        p_miss: of a look at a target.
        p_false: of a beam, or of a look.
        sigma_m: of a range.

    Example:
        >>> jax.eval_shape(lambda key: window(key).scans, jax.random.key(0)).range_m.shape
        (20, 90)
    """
    rates = Rates(p_miss, p_false, sigma_m)
    scene = motion_elements_scene()._replace(sonar=sonar_of(false_alarms, rates))
    inputs = Inputs(scene, shipped_gate(false_alarms, rates))
    return look(key, inputs, VARIANTS[false_alarms].false_alarms)


def sht(seen: Window) -> Tracks:
    """Return what the standard vote finds, cells over a threshold being targets."""
    paper = clustering_statistic.ClusteringParams()
    return clustering_statistic.threshold_estimate(seen.positions, paper)[0]


def csht(seen: Window) -> Tracks:
    """Return what the paper's transform finds."""
    paper = clustering_statistic.ClusteringParams()
    return clustering_statistic.estimate(seen.positions, paper)[0]


def joint_vote(seen: Window) -> Tracks:
    """Return what the joint vote finds, at the window's gate."""
    scene, gate = seen.inputs
    return _joint(seen.scans, scene.sonar, gate, seen.false_alarms)[0]


def floor(seen: Window) -> Estimates:
    """Return posterior means of those that are told which detection is whose."""
    return Estimates(_posterior_means(seen).state, seen.inputs.scene.truth.mask[-1])


def least_squares(seen: Window) -> Estimates:
    """Return least squares of the detections that are a target's."""
    scene = seen.inputs.scene
    squares = jax.vmap(
        lambda known, start: known_least_squares(known, scene.sonar, start, beams=BEAM_COUNT)
    )(_known(seen), scene.truth.state[-1])
    return Estimates(squares.state, scene.truth.mask[-1])


def velocity_ospa_m_s(seen: Window, found: Estimates | Tracks) -> Array:
    """Return the OSPA distance of velocities at the window's end."""
    return _ospa(seen, found, slice(2, 4))


def position_ospa_m(seen: Window, found: Estimates | Tracks) -> Array:
    """Return the OSPA distance of positions at the window's end."""
    return _ospa(seen, found, slice(0, 2))


def number_right(seen: Window, found: Estimates | Tracks) -> Array:
    """Return whether there are as many estimates as targets."""
    return found.mask.sum() == seen.inputs.scene.truth.mask[-1].sum()


@functools.cache
def search(false_alarms: str) -> Callable[[Key, Inputs], tuple[Array, Array]]:
    """Return the function of one window of which only the joint vote's scores [M] matter."""

    def run(key: Key, inputs: Inputs) -> tuple[Array, Array]:
        scene, gate = inputs
        scans = observe_beams(key, *scene, beams=BEAM_COUNT, false_alarms=false_alarms)
        tracks, _ = _joint(scans, scene.sonar, gate, false_alarms)
        return tracks.log_score, tracks.mask

    return run


@functools.cache
def vote_counts(false_alarms: str) -> Callable[[Key, SonarScene], tuple[Array, Array]]:
    """Return the function of one window's votes in the true lines' cells and away from them.

    The first is a mean, the second the strongest cell more than 1 m/s or 10 m from all true lines.
    """

    def run(key: Key, scene: SonarScene) -> tuple[Array, Array]:
        scans = observe_beams(key, *scene, beams=BEAM_COUNT, false_alarms=false_alarms)
        positions, _ = pack_beams(scans, scene.sonar, POSITIONS[false_alarms])
        paper = clustering_statistic.ClusteringParams()
        sizes = clustering_statistic.ClusteringSizes().lines
        votes = hard_votes(points_of(positions, 0), paper.x, sizes=sizes)
        velocity, start = cell_centres(paper.x, sizes=sizes, dtype=votes.dtype)
        truth = scene.truth.state[0]
        d_velocity = jnp.abs(velocity[None] - truth[:, 2, None])
        d_start = jnp.abs(start[None] - truth[:, 0, None])
        own = votes[d_velocity.argmin(1), d_start.argmin(1)]
        near = (d_velocity <= 1.0)[:, :, None] & (d_start <= 10.0)[:, None, :]
        return own.mean(), jnp.where(near.any(0), 0.0, votes).max()

    return run


def assumed(sonar: BeamSonar, false_alarms: str) -> BeamSensor:
    """Return the sonar as the beams' likelihood sees it: one false alarm a look is P_F/B a beam."""
    if false_alarms == "per_scan":
        sonar = sonar._replace(p_false=jnp.asarray(sonar.p_false) / BEAM_COUNT)
    return BeamSensor(sonar)


def _joint(
    scans: BeamScan, sonar: BeamSonar, gate: Array | float, false_alarms: str
) -> tuple[Tracks, joint.JointInfo]:
    params = joint.JointParams(assumed(sonar, false_alarms), SPEED, gate)
    return joint.estimate(scans, params, sizes=_SIZES[false_alarms], observation=BEAMS)


def _posterior_means(seen: Window) -> Any:
    scene = seen.inputs.scene
    start = scene.truth.state[-1]
    return jax.vmap(
        lambda key, known, start: known_posterior_mean(
            key, known, scene.sonar, SPEED, start, beams=BEAM_COUNT
        )
    )(jax.random.split(seen.draw, start.shape[0]), _known(seen), start)


def _known(seen: Window) -> KnownDetections:
    """Return every target's own detections, leaves [K, ...]."""
    scans = seen.scans
    elapsed_s = scans.time_s - scans.time_s[-1]

    def known(target: Array) -> KnownDetections:
        own = seen.origin == target
        beam = jnp.argmax(own, axis=1).astype(jnp.int32)
        range_m = jnp.take_along_axis(scans.range_m, beam[:, None], axis=1)[:, 0]
        return KnownDetections(elapsed_s, scans.pose, range_m, beam, own.any(axis=1))

    targets = seen.inputs.scene.truth.mask.shape[1]
    return jax.vmap(known)(jnp.arange(targets, dtype=jnp.int32))


def _ospa(seen: Window, found: Estimates | Tracks, of: slice) -> Array:
    truth = seen.inputs.scene.truth
    return ospa(
        found.mean[:, of],
        found.mask,
        truth.state[-1, :, of],
        truth.mask[-1],
        cutoff=CUTOFF,
        order=ORDER,
    ).distance
