"""What the study `learn_weights` simulates: looks with echoes, losses that train, the score.

Targets before a forward-looking sonar without a threshold of its own: nearly every beam reports
something. How loud an echo is tells target from clutter, but clutter comes in patches along the
beams. The joint vote knows nothing of loudness: it takes a weight for every detection, and what
gives the weights is compared.
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
from jaxtrack.numerics.masked import masked_mean
from jaxtrack.numerics.safe import safe_log
from jaxtrack.sensors import Echo, SonarSceneLimits, observe_known_beams, random_sonar_scene
from jaxtrack.sensors.echoes import echo_amplitudes
from jaxtrack.studies.learn.echoes import DEGREES, echo_log_ratio
from jaxtrack.types import Array, BeamScan, Key, Truth

BEAM_COUNT = 32
LOOKS = 12
TARGETS = 2
ECHO = Echo(snr_db=1.0, correlation_beams=12.0)
SONAR = BeamSonar(p_miss=0.3, p_false=0.9, clutter_in_missed_beam=1.0)
SPEED = SpeedGate(0.0, 6.0)
CUTOFF_M, ORDER = 20.0, 2.0
# What is tried on scenes of their own, for every method alike.
THRESHOLDS = (0.0, 0.4, 0.6, 0.8, 1.0)  # amplitudes; 0: all detections count alike
BOOSTS = (3.0, 10.0)
GATES = tuple(map(float, range(6, 19)))
START_GATE, TRAINED_BOOST = 13.0, 10.0
_NEAREST = 1e-3  # of a range over the scope
_NEAR_M = 15.0  # trajectories so near a target's at both ends are its own
_SIZES = joint.JointSizes(4, 2048, candidates=128, starts=8, gap=6, samples=64)
_RIVALS = 64  # trajectories of which a loss sets the strongest against the targets
_CLIMB = 3  # steps by which they are refined

_EXPECTED = TARGETS * (1 - SONAR.p_miss)
SHARE = _EXPECTED / (_EXPECTED + (BEAM_COUNT - _EXPECTED) * SONAR.p_false)  # of reports: targets'

Weights = dict[str, Any]
"""What `fit` trains: a network's arrays, and for the tracker's loss the gate."""
Network = Callable[[Any, BeamScan], Array]
"""`(arrays, looks) -> [T, B]`, log p(echo | target) − log p(echo | clutter) as far as it knows."""


class Window(NamedTuple):
    """One realization."""

    scans: BeamScan
    truth: Truth
    is_target: Array  # [T, B] the labels


def simulate(key: Key) -> Window:
    """Return looks at targets that move straight, and which echoes are theirs."""
    scene, look = jax.random.split(key)
    (truth, pose, sonar), _ = random_sonar_scene(
        scene, SONAR, SonarSceneLimits(), targets=TARGETS, looks=LOOKS, beams=BEAM_COUNT
    )
    scans, origin = observe_known_beams(
        look, truth, pose, sonar, beams=BEAM_COUNT, echo=ECHO, clutter_degrees=DEGREES
    )
    return Window(scans, truth, origin >= 0)


def true_log_ratio(scans: BeamScan) -> Array:
    """Return the true log-likelihood ratio of every echo: the ceiling."""
    assert scans.intensity is not None
    return echo_log_ratio(scans.intensity, scans.mask, ECHO, SHARE)


def weighted(scans: BeamScan, log_ratio: Array, boost: Any) -> tuple[BeamScan, BeamSensor]:
    """Return looks with weights w = Λ/(Λ + k), and the sensor that goes with them.

    A detection of weight w adds w (1 − P_M) ρ_D N/P_F to a look's likelihood ratio. With P_F/k in
    place of P_F and Λ ≪ k that is Λ times what it adds without an amplitude, as it should be; k
    bounds what a single echo can say.
    """
    weight = jax.nn.sigmoid(log_ratio - jnp.log(jnp.asarray(boost, log_ratio.dtype)))
    sensor = BeamSensor(SONAR._replace(p_false=SONAR.p_false / boost))
    return scans._replace(weight=jnp.where(scans.mask, weight, 0.0)), sensor


def label_loss(network: Network) -> Callable[[Weights, Key], Array]:
    """Return the binary cross-entropy of the labels.

    The odds are Λ times those of an echo at its range r: the share's times 2r/ρ_D, for targets are
    uniform over the area, clutter over the range. The vote, which goes over places, knows that: a
    network that learned it too would have it counted twice.
    """
    odds = jnp.log(SHARE / (1 - SHARE))

    def loss(weights: Weights, key: Key) -> Array:
        window = simulate(key)
        far = safe_log(2 * window.scans.range_m / SONAR.range_max_m, _NEAREST)
        logits = network(weights["network"], window.scans) + odds + far
        signed = jnp.where(window.is_target, -logits, logits)
        return masked_mean(jax.nn.softplus(signed).ravel(), window.scans.mask.ravel())

    return loss


def track_loss(network: Network) -> Callable[[Weights, Key], Array]:
    """Return the cross-entropy of the joint vote's existence σ(E − gate), a window.

        Σ_k log(1 + e^(gate − E_k)) + log(1 + e^(E_r − gate))

    with E the evidence about the targets k, at their true trajectories, and about the strongest
    trajectory r that is no target's. For it what the targets explain is taken out of the weights,
    as the joint vote takes it out. Which trajectory it is is a choice, and has no gradient.
    """

    def loss(weights: Weights, key: Key) -> Array:
        window = simulate(key)
        log_ratio = network(weights["network"], window.scans)
        gate = jnp.asarray(weights["gate"], log_ratio.dtype)
        scans, sensor = weighted(window.scans, log_ratio, TRAINED_BOOST)
        assert scans.weight is not None
        truth = window.truth.state[-1]  # all targets are there
        claim = jax.vmap(lambda x, scan: BEAMS.responsibility(x, scan, sensor))
        claims = jax.vmap(lambda state: claim(along(state, scans), scans))(truth)
        rest = scans.weight * jnp.prod(1 - claims, axis=0)
        rival, there = _rival(scans._replace(weight=rest), sensor, truth)

        def about(state: Array, weight: Array) -> Array:
            seen = scans._replace(weight=weight)
            options = {"samples": _SIZES.samples, "observation": BEAMS}
            return joint.evidence(state, seen, sensor, SPEED, **options)[2]

        found = jax.vmap(about)(
            jnp.concatenate([truth, rival[None]]), jnp.stack([scans.weight] * TARGETS + [rest])
        )
        false = jnp.where(there, jax.nn.softplus(found[-1] - gate), 0.0)
        return jax.nn.softplus(gate - found[:-1]).sum() + false

    return loss


def _rival(rest: BeamScan, sensor: BeamSensor, truth: Array) -> tuple[Array, Array]:
    """Return the strongest trajectory that is no target's, and whether there is one."""
    rest, sensor, truth = jax.lax.stop_gradient((rest, sensor, truth))
    positions = BEAMS.positions(rest, sensor)
    size = _SIZES.hypotheses
    start, some, _ = distant_pairs(positions, SPEED, gap=_SIZES.gap, hypotheses=size)
    wide = BEAMS.blur(sensor, 1.3)
    best = jax.lax.top_k(jnp.where(some, BEAMS.scores(start, rest, wide), -jnp.inf), _RIVALS)[1]
    climb = jax.vmap(lambda state: BEAMS.refine(state, rest, wide))
    states, _ = jax.lax.scan(lambda x, _: (climb(x), None), start[best], length=_CLIMB)

    def close(ago_s: Array) -> Array:
        at = lambda x: x[:, :2] + ago_s * x[:, 2:]
        return ((at(states)[:, None] - at(truth)[None]) ** 2).sum(-1) < _NEAR_M**2

    span_s = rest.time_s[0] - rest.time_s[-1]
    false = some[best] & ~(close(jnp.zeros_like(span_s)) & close(span_s)).any(-1)
    score = jnp.where(false, BEAMS.scores(states, rest, sensor), -jnp.inf)
    first = jnp.argmax(score)
    return jax.lax.stop_gradient(states[first]), false[first]


class Networks(NamedTuple):
    """Trained arrays, R of each stacked."""

    labels: Any
    tracks: Any


class Rates(NamedTuple):
    """What is left of all echoes above each of the thresholds, [thresholds]."""

    clutter: Array
    target: Array


def rates(key: Key) -> Rates:
    """Return the rates above the thresholds, from a hundred thousand draws of each kind."""
    looks = jnp.broadcast_to(jnp.arange(8000)[:, None] % 2 == 1, (8000, BEAM_COUNT))
    dtype = jnp.result_type(float)
    loud = echo_amplitudes(key, looks, ECHO, degrees=DEGREES, dtype=dtype)
    above = jnp.stack([(loud > a).mean(1, dtype=dtype) for a in THRESHOLDS])
    return Rates(above[:, ::2].mean(1), above[:, 1::2].mean(1))


def settings(repeats: int) -> list[tuple[str, int, float]]:
    """Return every setting that is scored: method, which of the trained networks, threshold or k.

    Example:
        >>> settings(2)[:6][-1], settings(2)[-1], len(settings(2))
        (('ceiling', 0, 3.0), ('tracks', 1, 10.0), 15)
    """
    found = [("threshold", 0, a) for a in THRESHOLDS]
    for method, count in (("ceiling", 1), ("labels", repeats), ("tracks", repeats)):
        found += [(method, n, k) for n in range(count) for k in BOOSTS]
    return found


@functools.cache
def score_with(network: Network) -> Callable[[Key, Any], Array]:
    """Return the trial `(key, (networks, rates, wanted)) -> OSPA` at the last look.

    It is [settings, gates], NaN for settings that are not wanted, which take no time.
    """

    def score(key: Key, params: tuple[Networks, Rates, Array]) -> Array:
        networks, left, wanted = params
        window = simulate(key)
        scans, dtype = window.scans, window.scans.range_m.dtype
        assert scans.intensity is not None
        ratios = [true_log_ratio(scans)[None]]
        ratios += [jax.vmap(network, (0, None))(arrays, scans) for arrays in networks]
        boosts = jnp.asarray(BOOSTS, dtype)
        looks, sensors = jax.vmap(jax.vmap(weighted, (None, None, 0)), (None, 0, None))(
            scans, jnp.concatenate(ratios), boosts
        )
        assert looks.weight is not None
        above = scans.intensity[None] > jnp.asarray(THRESHOLDS, dtype)[:, None, None]
        ones = jnp.ones_like(scans.range_m)
        mask = scans.mask[None] & above
        flat = lambda x: x.reshape(-1, *x.shape[2:])
        count = flat(looks.weight).shape[0]
        cases = (
            jnp.concatenate([mask, jnp.broadcast_to(scans.mask, (count, *scans.mask.shape))]),
            jnp.concatenate([jnp.broadcast_to(ones, mask.shape), flat(looks.weight)]),
            jnp.concatenate([1 - (1 - SONAR.p_miss) * left.target, jnp.full(count, SONAR.p_miss)]),
            jnp.concatenate([SONAR.p_false * left.clutter, flat(sensors.sonar.p_false)]),
        )

        def one(case: tuple[Array, ...]) -> Array:
            mask, weight, p_miss, p_false = case
            sonar = SONAR._replace(p_miss=p_miss, p_false=p_false)
            return _ospa(scans._replace(mask=mask, weight=weight), BeamSensor(sonar), window)

        nothing = lambda _: jnp.full(len(GATES), jnp.nan, dtype)
        either = lambda x: jax.lax.cond(x[0], one, nothing, x[1])
        return jax.lax.map(either, (wanted, cases))

    return score


def _ospa(scans: BeamScan, sensor: BeamSensor, window: Window) -> Array:
    """Return OSPA at each of the gates, [G]; tracks are found with the least of them."""
    params = joint.JointParams(sensor, SPEED, GATES[0])
    tracks, _ = joint.estimate(scans, params, sizes=_SIZES, observation=BEAMS)
    truth, there = window.truth.state[-1, :, :2], window.truth.mask[-1]

    def at(gate: Array) -> Array:
        mask = tracks.mask & (tracks.log_score >= gate)
        sets = tracks.mean[:, :2], mask, truth, there
        return ospa(*sets, cutoff=CUTOFF_M, order=ORDER).distance

    return jax.lax.map(at, jnp.asarray(GATES, truth.dtype))
