"""How likely a window makes a track, over all trajectories near one that was found."""

import math
from statistics import NormalDist
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.models.motion import look_times, propagate
from jaxtrack.models.observation import POSITION, Observation
from jaxtrack.numerics.definite import scaled_inverse, scaled_root
from jaxtrack.numerics.safe import safe_norm
from jaxtrack.types import Array, BeamScan, Scan

_ROUNDS = 2  # of sampling the posterior
_INFLATION = 1.2  # of the samples' spread over the posterior's


def evidence(
    state: Array,
    scans: Scan | BeamScan,
    sensor: Any,
    speed: SpeedGate,
    *,
    samples: int,
    observation: Observation = POSITION,
) -> tuple[Array, Array, Array, Array]:
    """Return posterior mean, covariance, evidence and whether the information was definite.

        log ∫ exp L(x) dx / (π (v_max² − v_min²))

    over places in m² and admissible velocities, by importance samples around a trajectory; no more
    than L at the mean, for where nothing is seen a wide volume alone is no track.

    Args:
        state: [4] where to look, at the time of the last look.
        scans: K looks stacked.
        sensor: the observation's.
        speed: admissible speeds.
        samples: how many, static.
        observation: the sensor's likelihood.

    Example:
        >>> from jaxtrack.models import PositionSensor
        >>> scans = Scan(2.0 * jnp.arange(5.0), jnp.ones(5, bool),
        ...              jnp.stack([400.0 * jnp.arange(5.0), jnp.full(5, 80.0)], -1)[:, None],
        ...              jnp.ones((5, 1), bool))
        >>> sensor = PositionSensor(p_detect=0.99, clutter_per_m2=1e-5, sigma_m=10.0)
        >>> weigh = jax.jit(lambda state: evidence(state, scans, sensor, SpeedGate(), samples=256))
        >>> mean, _, score, _ = weigh(jnp.array([1590.0, 90.0, 198.0, 2.0]))
        >>> print(jnp.abs(mean - jnp.array([1600.0, 80.0, 200.0, 0.0])).max() < 5.0, score > 10.0)
        True True
    """
    dtype = scans.time_s.dtype
    scans, _ = weighted(scans)
    fixed, fixed_sensor = jax.lax.stop_gradient((scans, sensor))
    information = observation.information(state, fixed, fixed_sensor) + _weak_prior(speed, dtype)
    points = jnp.asarray(_normal_points(samples), dtype)
    fastest, slowest = (jnp.asarray(v, dtype) for v in speed[::-1])
    disc = jnp.log(jnp.pi * (fastest**2 - slowest**2))  # of velocities, all alike likely
    definite, covariance, score = jnp.asarray(False), jnp.zeros_like(information), -disc
    for last in (False,) * (_ROUNDS - 1) + (True,):
        # Only the last round's weights carry gradients: where samples stand is no matter.
        at, given = (scans, sensor) if last else (fixed, fixed_sensor)
        root, definite = scaled_root(jax.lax.stop_gradient(information))
        states = jax.lax.stop_gradient(state)[None] + _INFLATION * points @ root
        pace = safe_norm(states[:, 2:4])
        inside = (pace >= speed.v_min_m_s) & (pace <= speed.v_max_m_s)
        value = observation.scores(states, at, given) + (points**2).sum(-1) / 2
        value = jnp.where(inside, value, -1e9)
        volume = jnp.log(2 * jnp.pi * _INFLATION**2) * 2 + jnp.log(jnp.diagonal(root)).sum()
        score = jax.nn.logsumexp(value) - math.log(samples) + volume - disc
        weight = jax.nn.softmax(value)
        state = weight @ states
        apart = states - state[None]
        # Without bias also where few samples have the weight: about their own mean they look close.
        few = 1 - (weight**2).sum()
        few = jnp.where(few > 1 / samples, few, 1 / samples)
        covariance = (weight[:, None] * apart).T @ apart / few
        # No narrower than a few samples can tell.
        information, _ = scaled_inverse(covariance + jnp.diag(jnp.diagonal(covariance)) * 0.05)
    at_mean = trajectory_score(state, scans, sensor, observation=observation)
    return state, covariance, jnp.where(score < at_mean, score, at_mean), definite


def trajectory_score(
    state: Array, scans: Scan | BeamScan, sensor: Any, *, observation: Observation
) -> Array:
    """Return L(x), the sum of the looks' log-likelihood ratios along a trajectory, in nats.

    Args:
        state: [4] at the time of the last look.
        scans: K looks stacked.
        sensor: the observation's.
        observation: the sensor's likelihood.
    """
    one = lambda x, scan: observation.log_likelihood_ratio(x, scan, sensor)
    return jax.vmap(one)(along(state, scans), scans).sum()


def weighted(scans: Any) -> tuple[Any, Array]:
    """Return scans with a weight for every detection and a time for every look, and the end."""
    counts = scans.mask & scans.valid[:, None]
    weight = jnp.ones(counts.shape, scans.time_s.dtype) if scans.weight is None else scans.weight
    _, end = look_times(scans)
    time_s = jnp.where(scans.valid, scans.time_s, end)
    return scans._replace(time_s=time_s, weight=jnp.where(counts, weight, 0.0)), end


def along(state: Array, scans: Scan | BeamScan) -> Array:
    """Return a state of the last look at every look, [K, 4]."""
    dt, _ = look_times(scans)
    return propagate(jnp.broadcast_to(state, (dt.shape[0], *state.shape)), dt)


def _weak_prior(speed: SpeedGate, dtype: Any) -> Array:
    """Return an information that says next to nothing: velocities are of the order of the gate's.

    Positions 100 s of travel apart: it keeps the samples finite where the detections do not.
    """
    v = jnp.asarray(speed.v_max_m_s, dtype)
    return jnp.diag(jnp.stack([(100 * v) ** -2, (100 * v) ** -2, v**-2, v**-2]))


def _normal_points(samples: int) -> np.ndarray:
    """Return evenly spread standard normal points, [samples, 4]: no draw, so no key.

    A Kronecker sequence through the inverse distribution function, every point with its mirror
    image, scaled to unit variances.
    """
    half = (samples + 1) // 2
    ratio = 1.1673039782614187  # the root of r⁵ = r + 1
    uniform = (0.5 + np.outer(np.arange(1, half + 1), ratio ** -np.arange(1.0, 5.0))) % 1
    normal = np.vectorize(NormalDist().inv_cdf)(np.clip(uniform, 1e-9, 1 - 1e-9))
    points = np.concatenate([normal, -normal])[:samples]
    return points / np.sqrt((points**2).mean(0))
