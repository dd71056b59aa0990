"""Joint space–time vote: each look adds its log-likelihood ratio instead of a count.

One vote in the four-dimensional space of constant-velocity trajectories,

    L(x) = Σ_k log p(look k | target on x) / p(look k | no target),

the statistic of maximum-likelihood track-before-detect. Candidates come from pairs of detections
some looks apart; the best of them are refined and the highest is taken; what it explains is taken
out of the detections' weights, and so on. Then all tracks are refitted together, each seeing what
the others leave. What the sensor is, only `models.observation` knows.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.hough.evidence import along, evidence, trajectory_score, weighted
from jaxtrack.hough.packing import pack_detections
from jaxtrack.hough.pairs import SpeedGate, distant_pairs
from jaxtrack.hough.tracks import tentative_tracks
from jaxtrack.models.line import line_through
from jaxtrack.models.observation import POSITION, Observation
from jaxtrack.numerics.checks import check_size
from jaxtrack.numerics.definite import scaled_inverse
from jaxtrack.numerics.safe import safe_divide
from jaxtrack.types import Array, BeamScan, Key, Lines, Scan, Tracks

_BLURS = (1.3, 1.3, 1.15, 1.0, 1.0, 1.0)  # widening of the noise, step by step of the refinement
_REFITS = 4  # rounds of the joint refit
_POLISH = 8  # steps of Newton's at the end,
_SHARES = (1.0, 1 / 2, 1 / 4, 1 / 16, 1 / 64, 0.0)  # and how much of one may be made
_SOME = 3  # every third look is among those that survivors are chosen by


class JointParams(NamedTuple):
    """Parameters of the joint vote. Traced."""

    sensor: Any  # the observation's; of `POSITION` a `PositionSensor`, of `BEAMS` a `BeamSensor`
    speed: SpeedGate = SpeedGate()
    gate: Array | float = 18.0  # tracks with a lower score (in nats) are masked out


class JointSizes(NamedTuple):
    """Everything that sets an array's shape. Static."""

    tracks: int = 6  # tracks that are looked for
    hypotheses: int = 32768  # pairs of detections that are scored
    candidates: int = 256  # the best of them, rescored for every track
    starts: int = 16  # the best of those, refined for every track
    gap: int = 3  # the two detections of a pair are at least so many looks apart
    detections: int | None = None  # a look that pairs are made of; None: as many as there is room
    survivors: int | None = None  # pairs scored on all looks, the best on some; None: all of them
    samples: int = 0  # of the posterior, whose mean is the estimate; 0: the likelihood's mode is


class JointInfo(NamedTuple):
    """What people look at."""

    responsibility: Array  # [M, K, N] how far each detection is a track's
    overflow: Array  # [] not all pairs were scored
    definite: Array  # [M] the information (with samples: and a weak prior) is positive definite
    hypothesis: Array  # [C, 4] the best candidates, at the last look
    hypothesis_score: Array  # [C] their scores with the noise widened


def estimate(
    scans: Scan | BeamScan,
    params: JointParams,
    key: Key | None = None,
    *,
    sizes: JointSizes = JointSizes(),  # noqa: B008 - an immutable tuple
    observation: Observation = POSITION,
) -> tuple[Tracks, JointInfo]:
    """Return the tracks of a window, with states at the last look, covariances and scores.

    Args:
        scans: K looks stacked, of the observation's kind.
        params: sensor, admissible speeds and gate.
        key: not used; part of every window estimator's signature.
        sizes: static sizes.
        observation: the sensor's likelihood.

    Returns:
        Tracks in order of their scores; `existence` is the posterior probability for prior log-odds
        of −gate. The search is not differentiated, nor what several tracks leave each other.
        Without samples: the likelihood's mode, whose gradient is that of the maximum by the
        implicit function theorem, its score L, and the inverse of the observed information, without
        a gradient. With samples: the posterior's mean, covariance and `evidence`, with gradients
        through the samples' weights; the evidence tells targets from clutter better than the
        maximum does, and is some nats less, so that its gate is lower.

    Raises:
        TypeError: a size is not a Python int.
        ValueError: a size is too small, there are not more than `sizes.gap` looks, or a known value
            of looks, sensor or speeds cannot be.

    Example:
        >>> scans = Scan(2.0 * jnp.arange(5.0), jnp.ones(5, bool),
        ...              jnp.stack([400.0 * jnp.arange(5.0), jnp.full(5, 80.0)], -1)[:, None],
        ...              jnp.ones((5, 1), bool))
        >>> from jaxtrack.models import PositionSensor
        >>> sensor = PositionSensor(p_detect=0.99, clutter_per_m2=1e-5, sigma_m=10.0)
        >>> run = jax.jit(lambda *at: estimate(*at, sizes=JointSizes(hypotheses=64)))
        >>> tracks, info = run(scans, JointParams(sensor))
        >>> print(int(tracks.mask.sum()), abs(tracks.mean[0].round(1)))
        1 [1600.   80.  200.    0.]
    """
    for name, value in zip(JointSizes._fields, sizes, strict=True):
        if value is not None:
            check_size(f"sizes.{name}", value, at_least=0 if name == "samples" else 1)
    scans = observation.check(scans, params.sensor)
    dtype = scans.time_s.dtype
    sensor = jax.tree.map(lambda x: jnp.asarray(x, dtype), params.sensor)
    gate = jnp.asarray(params.gate, dtype)
    scans, end = weighted(scans)
    fixed, fixed_sensor = jax.lax.stop_gradient((scans, sensor))
    whole = jnp.asarray(fixed.weight)

    found, crowded = pack_detections(observation.positions(fixed, fixed_sensor), sizes.detections)
    start, there, overflow = distant_pairs(
        found, params.speed, gap=sizes.gap, hypotheses=sizes.hypotheses
    )
    wide = observation.blur(fixed_sensor, _BLURS[0])
    rank = lambda states, there, scans: jnp.where(
        there, observation.scores(states, scans, wide), -jnp.inf
    )
    if sizes.survivors is not None:
        some = _every_third(fixed)
        best = jax.lax.top_k(rank(start, there, some), min(sizes.survivors, there.shape[0]))[1]
        start, there = start[best], there[best]
    score = rank(start, there, fixed)
    start_score, best = jax.lax.top_k(score, min(sizes.candidates, score.shape[0]))
    start, there = start[best], there[best]

    def climb(state: Array, scans: Any) -> Array:
        def step(state: Array, blur: Array) -> tuple[Array, None]:
            return observation.refine(state, scans, observation.blur(fixed_sensor, blur)), None

        return jax.lax.scan(step, state, jnp.asarray(_BLURS, dtype))[0]

    def claim(state: Array, weight: Array) -> Array:
        one = lambda x, scan: observation.responsibility(x, scan, fixed_sensor)
        return jax.vmap(one)(along(state, fixed), fixed._replace(weight=weight))

    def pick(free: Array, _: None) -> tuple[Array, tuple[Array, Array, Array]]:
        rest = fixed._replace(weight=whole * free)
        score = rank(start, there, rest)
        first = jax.lax.top_k(score, min(sizes.starts, score.shape[0]))[1]
        states = jax.vmap(lambda x: climb(x, rest))(start[first])
        score = jnp.where(there[first], observation.scores(states, rest, fixed_sensor), -jnp.inf)
        top = jnp.argmax(score)
        explained = claim(states[top], whole * free)
        return free * (1 - explained), (states[top], score[top], free)

    nothing = jnp.ones(scans.mask.shape, dtype)
    _, (states, picked, unexplained) = jax.lax.scan(pick, nothing, length=sizes.tracks)

    def finish(state: Array, free: Array) -> tuple[Array, ...]:
        def total(state: Array, scans: Any, sensor: Any) -> Array:
            seen = scans._replace(weight=jnp.asarray(scans.weight) * free)
            return trajectory_score(state, seen, sensor, observation=observation)

        def newton(state: Array, scans: Any, sensor: Any) -> tuple[Array, Array, Array]:
            """Return the step to the maximum as a parabola has it, and the inverse information."""
            information = -jax.hessian(total)(state, fixed, fixed_sensor)
            covariance, definite = scaled_inverse(information)
            slope = jax.grad(total)(state, scans, sensor)
            return jnp.where(definite, covariance @ slope, 0.0), covariance, definite

        def up(state: Array, _: None) -> tuple[Array, None]:
            """Go as much of the step as does not lead down: the search ends before the maximum."""
            move = newton(state, fixed, fixed_sensor)[0]
            states = state[None] + jnp.asarray(_SHARES, dtype)[:, None] * move[None]
            scores = jax.vmap(lambda x: total(x, fixed, fixed_sensor))(states)
            lost = (scores[-1] - scores) / (1 + abs(scores[-1]))
            return states[jnp.argmax(lost < 8 * jnp.finfo(dtype).eps)], None

        state, _ = jax.lax.scan(up, state, length=_POLISH)
        # A step from a fixed state carries the maximum's gradient, if it begins at the maximum.
        move, covariance, definite = newton(state, scans, sensor)
        refined = state + move - jax.lax.stop_gradient(move)
        return refined, covariance, total(refined, scans, sensor), definite

    def average(state: Array, free: Array) -> tuple[Array, ...]:
        seen = scans._replace(weight=jnp.asarray(scans.weight) * free)
        return evidence(
            state, seen, sensor, params.speed, samples=sizes.samples, observation=observation
        )

    # Only what passes the gate may take detections away from the others.
    strength = jax.vmap(average)(states, unexplained)[2] if sizes.samples else picked
    real = (strength >= gate).astype(dtype)[:, None, None]

    def refit(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        states, free = carry
        claims = real * jax.vmap(claim)(states, whole[None] * free)
        share = safe_divide(claims**2, claims.sum(0, keepdims=True))
        free = 1 - (share.sum(0, keepdims=True) - share)
        refine = lambda x, w: observation.refine(x, fixed._replace(weight=w), fixed_sensor)
        return (jax.vmap(refine)(states, whole[None] * free), free), None

    begin = states, jnp.ones_like(unexplained)
    (states, free), _ = jax.lax.scan(refit, begin, length=_REFITS)

    end_of_search = jax.lax.stop_gradient((states, free))
    found = jax.vmap(average if sizes.samples else finish)(*end_of_search)
    mean, covariance, score, definite = found
    keep = (score >= gate) & jnp.isfinite(picked)
    order = jnp.argsort(jnp.where(keep, -score, jnp.inf))
    table = mean, covariance, score, keep, free, definite
    mean, covariance, score, keep, free, definite = (x[order] for x in table)
    claims = jax.vmap(claim)(jax.lax.stop_gradient(mean), whole[None] * free)
    tracks = tentative_tracks(
        end, mean, covariance, keep, existence=jax.nn.sigmoid(score - gate), log_score=score
    )
    claims = jnp.where(keep[:, None, None], claims, 0)
    overflow = overflow | crowded
    return tracks, JointInfo(claims, overflow, keep & definite, start, start_score)


def lines_of(tracks: Tracks) -> Lines:
    """Return the lines that tracks move on, with their scores as votes, ρ from (0, 0).

    Example:
        >>> from jaxtrack.types import Tracks
        >>> one = jnp.ones(1)
        >>> tracks = Tracks(one[0], jnp.array([[3.0, 8.0, 1.0, 0.0]]), jnp.eye(4)[None], one > 0,
        ...                 one, one, one, 20 * one)
        >>> print(lines_of(tracks).rho_m, lines_of(tracks).votes)
        [8.] [20.]
    """
    position, velocity = tracks.mean[:, :2], tracks.mean[:, 2:4]
    moves = tracks.mask & (velocity != 0).any(-1)
    # A target that stands still has no line: it is masked out.
    step = jnp.where(moves[:, None], velocity, 1.0)
    rho, theta = line_through(position, position + step, jnp.zeros(2, position.dtype))
    clear = lambda x: jnp.where(moves, x, 0.0)
    return Lines(clear(rho), clear(theta), clear(tracks.log_score), moves)


def _every_third(scans: Any) -> Any:
    """Return every third look, the last valid one, at which states stand, among them."""
    looks = scans.valid.shape[0]
    last = jnp.where(scans.valid, jnp.arange(looks, dtype=jnp.int32), 0).max()
    behind = jnp.arange(looks - 1, -1, -_SOME, dtype=jnp.int32)[::-1] - (looks - 1)
    # What wraps around stands behind the last valid look, and says nothing.
    return jax.tree.map(lambda x: x[(last + behind) % looks], scans)
