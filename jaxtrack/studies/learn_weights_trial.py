"""What the study `learn_weights` simulates: looks with echoes, losses that train, scores that count.

Targets before a forward-looking sonar whose beams report something every other time. How loud an
echo is tells target from clutter, but the clutter comes in patches along the beams. The joint vote
knows nothing of loudness: it takes a weight for every detection, and what gives the weights is
compared.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.hough import SpeedGate, joint
from jaxtrack.hough.evidence import along
from jaxtrack.hough.pairs import distant_pairs
from jaxtrack.metrics import ospa
from jaxtrack.models import BEAMS, BeamSensor, BeamSonar
from jaxtrack.numerics.masked import masked_logsumexp, masked_mean
from jaxtrack.sensors import Echo, SonarSceneLimits, observe_known_beams, random_sonar_scene
from jaxtrack.studies.learn_echoes import DEGREES, echo_log_ratio
from jaxtrack.types import Array, BeamScan, Key, Truth

BEAM_COUNT = 32
LOOKS = 12
TARGETS = 2
ECHO = Echo(snr_db=1.0, correlation_beams=12.0)
SONAR = BeamSonar(p_miss=0.3, p_false=0.9, clutter_in_missed_beam=1.0)
SPEED = SpeedGate(0.0, 6.0)
CUTOFF_M, ORDER = 20.0, 2.0
NEAR_M = 15.0  # trajectories so near a target's at both ends are its own
_SIZES = joint.JointSizes(4, 2048, candidates=128, starts=8, gap=6, samples=64)
_FALSE = 64  # trajectories that a loss sets against the targets
_CLIMB = 3  # steps by which they are refined

# Of the echoes that there are: 2 targets in 32 beams.
_REPORTS = TARGETS * (1 - SONAR.p_miss), (BEAM_COUNT - TARGETS * (1 - SONAR.p_miss)) * SONAR.p_false
SHARE = _REPORTS[0] / sum(_REPORTS)

Weigh = Callable[[Any, BeamScan], Array]
"""`(params, looks) -> log-odds [T, B]` that an echo is a target's rather than clutter."""


class Window(NamedTuple):
    """One realization, as all methods see it."""

    scans: BeamScan
    truth: Truth
    is_target: Array  # [T, B] labels


def simulate(key: Key) -> Window:
    """Return looks at targets that move straight, and which echoes are theirs."""
    scene, look = jax.random.split(key)
    limits = SonarSceneLimits()
    (truth, pose, sonar), _ = random_sonar_scene(
        scene, SONAR, limits, targets=TARGETS, looks=LOOKS, beams=BEAM_COUNT
    )
    scans, origin = observe_known_beams(
        look, truth, pose, sonar, beams=BEAM_COUNT, echo=ECHO, clutter_degrees=DEGREES
    )
    return Window(scans, truth, origin >= 0)


def true_log_ratio(_: Any, scans: BeamScan) -> Array:
    """Return the true log-likelihood ratio of every echo: the ceiling."""
    assert scans.intensity is not None
    return echo_log_ratio(scans.intensity, scans.mask, ECHO, SHARE)


def weighted(scans: BeamScan, log_ratio: Array, boost: Array) -> tuple[BeamScan, BeamSensor]:
    """Return looks with weights w = Λ/(Λ + k), and the sensor that goes with them.

    A detection of small weight counts w (1 − P_M) ρ_D N/P_F: with P_F/k in place of P_F that is Λ
    times what it would count without an amplitude, as it should be. k bounds what one echo can say.
    """
    weight = jax.nn.sigmoid(log_ratio - jnp.log(boost))
    sensor = BeamSensor(SONAR._replace(p_false=SONAR.p_false / boost))
    return scans._replace(weight=jnp.where(scans.mask, weight, 0.0)), sensor


def label_loss(log_ratio: Array, window: Window) -> Array:
    """Return the binary cross-entropy of the labels, the log-odds being Λ times the share's."""
    logits = log_ratio + jnp.log(SHARE / (1 - SHARE))
    signed = jnp.where(window.is_target, -logits, logits)
    return masked_mean(jax.nn.softplus(signed), window.scans.mask)


def track_loss(log_ratio: Array, gate: Array, boost: Array, window: Window) -> Array:
    """Return the cross-entropy of the joint vote's existence, σ(L − gate).

        Σ_k log(1 + e^(gate − L_k)) + log(1 + Σ_c e^(L_c − gate))

    over the targets' true trajectories and the strongest of all that are none's, these with what
    the targets explain taken out of the weights, as the joint vote takes it out.
    """
    scans, sensor = weighted(window.scans, log_ratio, boost)
    truth, there = window.truth.state[-1], window.truth.mask.any(0)
    own = BEAMS.scores(truth, scans, sensor)
    claim = lambda state: jax.vmap(lambda x, scan: BEAMS.responsibility(x, scan, sensor))(
        along(state, scans), scans
    )
    claims = jnp.where(there[:, None, None], jax.vmap(claim)(truth), 0.0)
    left = jnp.prod(1 - claims, axis=0)
    rest = scans._replace(weight=scans.weight * left)

    fixed, fixed_sensor = jax.lax.stop_gradient((rest, sensor))
    start, some, _ = distant_pairs(
        BEAMS.positions(fixed, fixed_sensor)._replace(weight=None),
        SPEED,
        gap=_SIZES.gap,
        hypotheses=_SIZES.hypotheses,
    )
    wide = BEAMS.blur(fixed_sensor, 1.3)
    score = jnp.where(some, BEAMS.scores(start, fixed, wide), -jnp.inf)
    best = jax.lax.top_k(score, _FALSE)[1]
    start, some = start[best], some[best]

    def climb(state: Array) -> Array:
        step = lambda x, _: (BEAMS.refine(x, fixed, wide), None)
        return jax.lax.scan(step, state, length=_CLIMB)[0]

    states = jax.lax.stop_gradient(jax.vmap(climb)(start))
    near = jnp.ones((_FALSE, TARGETS), bool)
    span = scans.time_s[0] - scans.time_s[-1]
    for ago in (0.0, span):
        apart = (states[:, None, :2] + ago * states[:, None, 2:]) - (
            truth[None, :, :2] + ago * truth[None, :, 2:]
        )
        close = (apart**2).sum(-1) < NEAR_M**2
        near = near & close
    false = some & ~(near & there[None]).any(-1)
    rival = masked_logsumexp(jnp.where(false, BEAMS.scores(states, rest, sensor), 0.0), false)
    found = jnp.where(there, jax.nn.softplus(gate - own), 0.0).sum()
    return found + jax.nn.softplus(jnp.where(false.any(), rival - gate, -30.0))


class Score(NamedTuple):
    """OSPA of the joint vote at each setting."""

    ospa_m: Array  # [...]
    count: Array  # [...] tracks


def judge(
    scans: BeamScan, sensor: BeamSensor, gates: Array, window: Window
) -> Score:
    """Return what the joint vote is worth on weighted looks at each of the gates, [G].

    A gate only masks tracks here: tracks are found with the least one, and refitted together.
    """
    params = joint.JointParams(sensor, SPEED, gates[0])
    tracks, _ = joint.estimate(scans, params, sizes=_SIZES, observation=BEAMS)
    truth, there = window.truth.state[-1], window.truth.mask[-1]

    def at(gate: Array) -> Score:
        mask = tracks.mask & (tracks.log_score >= gate)
        far = ospa(
            tracks.mean[:, :2], mask, truth[:, :2], there, cutoff=CUTOFF_M, order=ORDER
        ).distance
        return Score(far, mask.sum())

    return jax.lax.map(at, gates)
