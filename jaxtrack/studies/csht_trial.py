"""One trial of the study `csht_estimation`: a window is simulated once, and all see the same looks.

The scene, the sonar's rates and the gate are traced: every cell of every table is the same compiled
program. Only the false-alarm model is static.
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
from jaxtrack.sensors import SonarScene, observe_beams, observe_known_beams
from jaxtrack.types import Array, BeamScan, Key, Tracks

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
        look, draw = jax.random.split(key)
        scene = inputs.scene
        scans, origin = observe_known_beams(
            look, *scene, beams=BEAM_COUNT, false_alarms=false_alarms
        )
        tracks, info = _joint(scans, scene.sonar, inputs.gate, false_alarms)
        positions, _ = pack_beams(scans, scene.sonar, POSITIONS[false_alarms])
        paper = clustering_statistic.ClusteringParams()
        sht, _ = clustering_statistic.threshold_estimate(positions, paper)
        csht, _ = clustering_statistic.estimate(positions, paper)

        truth, there = scene.truth.state[-1], scene.truth.mask[-1]
        known = [_known(scans, origin, target) for target in range(there.shape[0])]
        known = jax.tree.map(lambda *x: jnp.stack(x), *known)
        squares = jax.vmap(
            lambda seen, start: known_least_squares(seen, scene.sonar, start, beams=BEAM_COUNT)
        )(known, truth)
        means = jax.vmap(
            lambda key, seen, start: known_posterior_mean(
                key, seen, scene.sonar, SPEED, start, beams=BEAM_COUNT
            )
        )(jax.random.split(draw, there.shape[0]), known, truth)
        estimates = {
            "SHT": (sht.mean, sht.mask),
            "CSHT": (csht.mean, csht.mask),
            "joint": (tracks.mean, tracks.mask),
            "floor": (means.state, there),
            "least squares": (squares.state, there),
        }
        errors = {name: _errors(*found, truth, there) for name, found in estimates.items()}
        sensor = assumed(scene.sonar, false_alarms)
        samples = _SIZES[false_alarms].samples
        score = jax.vmap(
            lambda x: joint.evidence(x, scans, sensor, SPEED, samples=samples, observation=BEAMS)[2]
        )(truth)
        passes = all_pass_at_truth(score, there, inputs.gate)
        effective = jnp.where(there, means.effective_samples, jnp.inf).min()
        return Outcome(
            errors, there.sum(), passes, info.overflow, effective, within=jnp.asarray(True)
        )

    return run


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


def _known(scans: BeamScan, origin: Array, target: int) -> KnownDetections:
    own = origin == target
    beam = jnp.argmax(own, axis=1).astype(jnp.int32)
    range_m = jnp.take_along_axis(scans.range_m, beam[:, None], axis=1)[:, 0]
    elapsed_s = scans.time_s - scans.time_s[-1]
    return KnownDetections(elapsed_s, scans.pose, range_m, beam, own.any(axis=1))


def _errors(state: Array, mask: Array, truth: Array, there: Array) -> Errors:
    distance: Callable[..., Any] = lambda of: (
        ospa(state[:, of], mask, truth[:, of], there, cutoff=CUTOFF, order=ORDER).distance
    )
    return Errors(distance(slice(2, 4)), distance(slice(0, 2)), mask.sum())
