"""Floors: what an estimator of one target's motion could reach if it knew which detections are its.

With known association a multi-beam sonar gives ranges with Gaussian noise and bearings that are
uniform inside their beams, so that

    p(x | detections) ∝ p(x) Π_k N(r_k; ρ_k(x), σ²) 1[b_k ≤ u_k(x) ≤ b_k + 1].

Its mean is the floor of the mean square error. Least squares, with a beam's bearing taken as
Gaussian of the same variance, is the reference beside it. The Cramér–Rao bound does not apply to
uniform beams.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.frames import earth_to_polar
from jaxtrack.models.motion import propagate
from jaxtrack.models.sonar import BeamSonar, check_sonar
from jaxtrack.numerics.checks import check_array, check_size
from jaxtrack.numerics.definite import scaled_inverse, scaled_root
from jaxtrack.numerics.safe import safe_norm, wrap_angle
from jaxtrack.types import Array, Key, Pose

_FIT_STEPS = 10
_SOFTNESS = (0.5, 0.25, 0.1, 0.0)  # of the beams' edges, in beams, round by round
_INFLATION = 1.3  # of the samples' spread over the posterior's


class KnownDetections(NamedTuple):
    """One target's own detections in a window, at most one a look."""

    elapsed_s: Array  # [T] time of the look minus that of the state
    pose: Pose  # position_m [T, 2], heading_rad [T]
    range_m: Array  # [T]
    beam: Array  # [T] int, counted from the port edge
    mask: Array  # [T] the target was detected


class PosteriorMean(NamedTuple):
    """The floor of one target in one run."""

    state: Array  # [4]
    covariance: Array  # [4, 4] of the posterior
    # [] 1 / Σ w². Some dozens do: against 16384 samples 1024 made the floor too high by .2 % in
    # position and −.1 % in velocity at P_M = P_F = .3, where the fewest of three targets were 74 in
    # the median, and by .2 and .3 % at .1, with 35 (standard errors .2 %; 300 and 600 paired runs);
    # 300 runs of another seed, with 58, gave .4 and .7 %.
    effective_samples: Array


class LeastSquares(NamedTuple):
    """The reference of one target in one run."""

    state: Array  # [4]
    covariance: Array  # [4, 4] inverse information
    determined: Array  # [] False: too few detections, the state is where it started


def known_least_squares(
    detections: KnownDetections, sonar: BeamSonar, start: Array, *, beams: int
) -> LeastSquares:
    """Fit a trajectory to detections of known origin, by Gauss–Newton steps.

        x̂ = argmin Σ_k (r_k − ρ_k(x))²/σ² + 12 (b_k + ½ − u_k(x))²

    Args:
        detections: of one target.
        sonar: range noise, sector and mount are used.
        start: [4] where to start: the truth, as a rule.
        beams: number of beams, static.

    Example:
        >>> sonar, dt = BeamSonar(), jnp.array([-2.0, -1.0, 0.0])
        >>> pose = Pose(jnp.zeros((3, 2)), jnp.zeros(3))
        >>> seen = KnownDetections(dt, pose, 50.0 + dt, jnp.full(3, 45), jnp.ones(3, bool))
        >>> fit = known_least_squares(seen, sonar, jnp.array([50.0, 0.4, 1.0, 0.0]), beams=90)
        >>> print(abs(fit.state).round(1), fit.determined)
        [50.   0.4  1.   0. ] True

    Source: the genie of the readings of the clustering-statistic Hough transform (2018), table 1.
    """
    _check(detections, sonar, start, beams)
    # The weakest of pulls to the start keeps a singular fit where it is.
    state, information = _fit(detections, sonar, start, jnp.zeros((4, 4), start.dtype), beams)
    covariance, determined = scaled_inverse(information)
    return LeastSquares(jnp.where(determined, state, start), covariance, determined)


def known_posterior_mean(
    key: Key,
    detections: KnownDetections,
    sonar: BeamSonar,
    speed_m_s: tuple[Any, Any],
    start: Array,
    *,
    beams: int,
    samples: int = 1024,
) -> PosteriorMean:
    """Return the posterior mean of a trajectory given detections of known origin.

    The prior is uniform over velocities of admissible speed and over places within the sonar's
    scope at the state's time; a look without a detection has probability P_M inside the sector and
    1 outside. Importance sampling in rounds: the first draws from the Gaussian of least squares and
    grants the beams soft edges, each later one draws from the Gaussian that the one before found,
    the last is exact.

    Args:
        key: random key.
        detections: of one target.
        sonar: range noise, miss probability, scope, sector and mount are used.
        speed_m_s: least and largest speed of the prior.
        start: [4] where to start: the truth, as a rule.
        beams: number of beams, static.
        samples: in each round, static.

    Example:
        >>> sonar, dt = BeamSonar(), jnp.array([-2.0, -1.0, 0.0])
        >>> pose = Pose(jnp.zeros((3, 2)), jnp.zeros(3))
        >>> seen = KnownDetections(dt, pose, 50.0 + dt, jnp.full(3, 45), jnp.ones(3, bool))
        >>> floor = known_posterior_mean(
        ...     jax.random.key(0), seen, sonar, (0.0, 6.0), jnp.array([50.0, 0.4, 1.0, 0.0]),
        ...     beams=90,
        ... )
        >>> bool(0.3 < floor.state[1] < 0.6), bool(floor.effective_samples > 100)
        (True, True)
    """
    _check(detections, sonar, start, beams)
    check_size("samples", samples, at_least=8)
    dtype = start.dtype
    scope, fastest = jnp.asarray(sonar.range_max_m, dtype), jnp.asarray(speed_m_s[1], dtype)
    weak = jnp.diag(jnp.stack([scope, scope, fastest, fastest]) ** -2.0)
    state, information = _fit(detections, sonar, start, weak, beams)
    covariance = jnp.zeros_like(information)
    weight = jnp.zeros(samples, dtype)
    for softness, one in zip(_SOFTNESS, jax.random.split(key, len(_SOFTNESS)), strict=True):
        half = jax.random.normal(one, ((samples + 1) // 2, 4), dtype)
        points = jnp.concatenate([half, -half])[:samples]
        states = state[None] + _INFLATION * points @ scaled_root(information)[0]
        density = jax.vmap(lambda x, s=softness: _log_density(x, detections, sonar, beams, s))
        speed = safe_norm(states[:, 2:])
        allowed = (speed >= speed_m_s[0]) & (speed <= fastest)
        value = jnp.where(allowed, density(states) + (points**2).sum(-1) / 2, -1e9)
        weight = jax.nn.softmax(value)
        state = weight @ states
        apart = states - state[None]
        covariance = (weight[:, None] * apart).T @ apart
        # At least a tenth of the spread before: a round that hits nothing must not collapse.
        before, _ = scaled_inverse(information)
        information, _ = scaled_inverse(covariance + 0.01 * before)
    return PosteriorMean(state, covariance, 1 / (weight**2).sum())


def all_pass_at_truth(scores: Array, mask: Array, gate: Array | float) -> Array:
    """Return whether every target's score, taken at the truth, passes a gate.

    Its mean over runs is the information ceiling: where the window does not tell a target from
    clutter even to one who knows where to look, a search finds it by luck alone. (The maximum lies
    above the score at the truth, so a search can pass this share a little.)

    Args:
        scores: [M] of the true states, by the likelihood or the evidence that the gate is for.
        mask: [M] which targets exist.
        gate: in nats.

    Example:
        >>> scores, there = jnp.array([12.0, 3.0]), jnp.array([True, False])
        >>> print(all_pass_at_truth(scores, there, 9.0), all_pass_at_truth(scores, there, 15.0))
        True False
    """
    check_array("scores", scores, shape=("M",))
    check_array("mask", mask, shape=jnp.shape(scores))
    return ((scores >= jnp.asarray(gate, scores.dtype)) | ~mask).all()


def _check(detections: KnownDetections, sonar: BeamSonar, start: Array, beams: int) -> None:
    check_size("beams", beams)
    check_sonar(sonar)
    check_array("start", start, shape=(4,))
    check_array("detections.range_m", detections.range_m, shape=("T",))
    check_array("detections.beam", detections.beam, shape=jnp.shape(detections.range_m))


def _seen(state: Array, detections: KnownDetections, sonar: BeamSonar, beams: int) -> Array:
    """Return range, and bearing in beams from the port edge, at every look, [T, 2]."""
    looks = detections.elapsed_s.shape[0]
    states = propagate(jnp.broadcast_to(state, (looks, 4)), detections.elapsed_s)
    at = jax.vmap(lambda x, pose: earth_to_polar(x, pose, sonar.mount_m))
    range_m, bearing = at(states[:, :2], detections.pose)
    width = jnp.asarray(sonar.sector_rad, state.dtype) / beams
    return jnp.stack([range_m, bearing / width + beams / 2], axis=-1)


def _fit(
    detections: KnownDetections, sonar: BeamSonar, start: Array, prior: Array, beams: int
) -> tuple[Array, Array]:
    """Return the least-squares state and its information, with a Gaussian prior about the start."""
    dtype = start.dtype
    inverse_variance = jnp.stack(
        [jnp.asarray(sonar.sigma_m, dtype) ** -2, jnp.asarray(12.0, dtype)]
    )
    weight = jnp.where(detections.mask[:, None], inverse_variance[None], 0.0)
    reported = jnp.stack(
        [
            jnp.where(detections.mask, detections.range_m, 0.0),
            jnp.where(detections.mask, detections.beam, 0).astype(dtype) + 0.5,
        ],
        axis=-1,
    )
    seen = lambda state: _seen(state, detections, sonar, beams)
    width = jnp.asarray(sonar.sector_rad, dtype) / beams

    def normal(state: Array) -> tuple[Array, Array]:
        slope, rest = jax.jacfwd(seen)(state), reported - seen(state)
        rest = rest.at[:, 1].set(wrap_angle(rest[:, 1] * width) / width)
        information = prior + jnp.einsum("tc,tci,tcj->ij", weight, slope, slope)
        return information, jnp.einsum("tc,tci,tc->i", weight, slope, rest) + prior @ (
            start - state
        )

    def step(_: int, state: Array) -> Array:
        information, push = normal(state)
        inverse, definite = scaled_inverse(information)
        return state + jnp.where(definite, inverse @ push, 0.0)

    state = jax.lax.fori_loop(0, _FIT_STEPS, step, start)
    return state, normal(state)[0]


def _log_density(
    state: Array, detections: KnownDetections, sonar: BeamSonar, beams: int, softness: float
) -> Array:
    """Log-posterior of a state up to a constant, with Gaussian tails of `softness` at the edges."""
    range_m, at = _seen(state, detections, sonar, beams).T
    sigma = jnp.asarray(sonar.sigma_m, state.dtype)
    scope = jnp.asarray(sonar.range_max_m, state.dtype)
    known = detections.mask
    far = jnp.where(known, detections.range_m - range_m, 0.0) / sigma
    beam = jnp.where(known, detections.beam, 0).astype(state.dtype)
    beyond = jnp.where(known, jnp.abs(at - beam - 0.5) - 0.5, 0.0)
    outside = jnp.where(beyond > 0, beyond, 0.0)
    visible = (at >= 0) & (at <= beams) & (range_m <= scope)
    miss = jnp.where(~known & visible, jnp.log(jnp.asarray(sonar.p_miss, state.dtype)), 0.0)
    edge = jnp.where(outside > 0, -1e4, 0.0) if softness == 0 else -((outside / softness) ** 2) / 2
    # The prior's field: within the scope at the time of the state, which a look may stand at.
    here = jnp.argmin(jnp.abs(detections.elapsed_s))
    field = jnp.where(range_m[here] <= scope + 3 * sigma, 0.0, -1e4)
    return (miss + edge - far**2 / 2).sum() + field
