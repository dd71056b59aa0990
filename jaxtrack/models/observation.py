"""What one look says about a target in a given state.

A target at x is detected with probability P_D, its position blurred by R, in Poisson clutter of
density λ. The log-likelihood ratio of the look against clutter alone is then

    log[ 1 − P_D + (P_D / λ) Σ_j w_j N(z_j; H x(t_j), R_j) ].

An `Observation` bundles what the joint vote (`hough.joint`) asks of a sensor; `POSITION` is that
bundle for sensors that report positions. Another sensor brings another bundle.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.motion import look_times, propagate
from jaxtrack.numerics.checks import check_positive, check_probability, check_scans
from jaxtrack.numerics.safe import safe_divide, safe_log
from jaxtrack.types import Array, LogLikelihoodRatio, Scan


class PositionSensor(NamedTuple):
    """What a position sensor's likelihood needs. Traced."""

    p_detect: Array | float  # [] probability that a target is detected in a look
    clutter_per_m2: Array | float  # [] λ, expected false detections a square metre and look
    sigma_m: Array | float  # [] noise of each coordinate, where a scan has no covariance of its own
    widening: Array | float = 1.0  # [] factor on the noise, a scan's own covariance included


class Observation(NamedTuple):
    """A sensor as the joint vote sees it. Static: functions only.

    States of a window stand at its last look. `scores(states [H, 4], scans, sensor) -> [H]` sums
    the log-likelihood ratio over the looks, `responsibility(state, scan, sensor)` is how far each
    detection of a look is the target's, `refine(state, scans, sensor)` moves a state uphill,
    `blur(sensor, factor)` widens the noise, `positions(scans, sensor)` gives the detections' places
    in the earth frame, and `information(state, scans, sensor) -> [4, 4]` what those that a state
    claims tell about it. `check(scans, sensor)` refuses known values that cannot be, and returns
    sound looks.
    """

    log_likelihood_ratio: LogLikelihoodRatio
    scores: Callable[[Array, Any, Any], Array]
    responsibility: Callable[[Array, Any, Any], Array]
    refine: Callable[[Array, Any, Any], Array]
    blur: Callable[[Any, Array | float], Any]
    positions: Callable[[Any, Any], Scan]
    information: Callable[[Array, Any, Any], Array]
    check: Callable[[Any, Any], Any]


def position_log_likelihood_ratio(state: Array, scan: Scan, params: PositionSensor) -> Array:
    """Return log p(look | target at state) − log p(look | no target), in nats.

    Args:
        state: [4] x, y, vx, vy at the look's time.
        scan: one look; its weights multiply the densities, its delays move the state.
        params: detection probability, clutter density and noise.

    Returns:
        A scalar; 0 for an invalid look, log(1 − P_D) for a valid one without detections.

    Example:
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.zeros((1, 2)), jnp.array([True]))
        >>> sensor = PositionSensor(p_detect=0.9, clutter_per_m2=1e-5, sigma_m=10.0)
        >>> print(f"{position_log_likelihood_ratio(jnp.zeros(4), scan, sensor):.2f}")
        4.97

    Source: the statistic of maximum-likelihood track-before-detect; see `docs/design.md`.
    """
    total = _ratios(state, scan, params).sum()
    miss = 1 - jnp.asarray(params.p_detect, state.dtype)
    return jnp.where(scan.valid, safe_log(miss + total), 0.0)


def position_responsibility(state: Array, scan: Scan, params: PositionSensor) -> Array:
    """Return the posterior probability that each detection is the target's, [N].

        r_j = (P_D/λ) w_j N_j / (1 − P_D + (P_D/λ) Σ_i w_i N_i)

    Args:
        state: [4] x, y, vx, vy at the look's time.
        scan: one look.
        params: as in `position_log_likelihood_ratio`.

    Example:
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.zeros((1, 2)), jnp.array([True]))
        >>> sensor = PositionSensor(p_detect=0.9, clutter_per_m2=1e-5, sigma_m=10.0)
        >>> print(f"{position_responsibility(jnp.zeros(4), scan, sensor)[0]:.3f}")
        0.999
    """
    ratio = _ratios(state, scan, params)
    miss = 1 - jnp.asarray(params.p_detect, state.dtype)
    return safe_divide(ratio, miss + ratio.sum())


def position_scores(states: Array, scans: Scan, params: PositionSensor) -> Array:
    """Return the log-likelihood ratio of a window for many trajectories at once, [H].

        L(x) = Σ_k log[1 − P_D + (P_D/λ) Σ_j w_kj N(z_kj; H x(t_kj), R_kj)]

    The sum of `position_log_likelihood_ratio` over the looks. It walks over the detections and
    keeps the trajectories in the inner loop: on a CPU nine times as fast as `vmap` of the sum.

    Args:
        states: [H, 4] at the time of the last look.
        scans: K looks stacked.
        params: detection probability, clutter density and noise.

    Example:
        >>> scans = Scan(jnp.zeros(1), jnp.ones(1, bool), jnp.zeros((1, 1, 2)),
        ...              jnp.ones((1, 1), bool))
        >>> sensor = PositionSensor(p_detect=0.9, clutter_per_m2=1e-5, sigma_m=10.0)
        >>> print(f"{position_scores(jnp.zeros((1, 4)), scans, sensor)[0]:.2f}")
        4.97
    """
    miss = 1 - jnp.asarray(params.p_detect, states.dtype)
    columns = states.T
    scans = scans._replace(time_s=look_times(scans)[0])

    def look(total: Array, scan: Scan) -> tuple[Array, None]:
        dt = scan.time_s

        def detection(ratio: Array, one: Detection) -> tuple[Array, None]:
            return ratio + _ratio(columns, dt, one), None

        ratio, _ = jax.lax.scan(detection, jnp.zeros_like(total), _detections(scan, params))
        return total + jnp.where(scan.valid, safe_log(miss + ratio), 0.0), None

    return jax.lax.scan(look, jnp.zeros_like(columns[0]), scans)[0]


def position_refine(state: Array, scans: Scan, params: PositionSensor) -> Array:
    """Return the trajectory fitted to the detections that a trajectory claims: one EM step.

        x' = argmin Σ_kj r_kj |z_kj − p − v (t_kj − t_K)|² / σ_kj²

    Never lowers the window's score (for isotropic noise). Where fewer than two distinct times
    have claimed detections the state stays.

    Args:
        state: [4] at the time of the last look.
        scans: K looks stacked.
        params: detection probability, clutter density and noise.
    """
    time, _ = look_times(scans)
    states = propagate(jnp.broadcast_to(state, (time.shape[0], 4)), time)
    claimed = jax.vmap(lambda x, scan: position_responsibility(x, scan, params))(states, scans)
    one = jax.vmap(lambda scan: _detections(scan, params))(scans)
    weight = claimed / (one.xx_m2 + one.yy_m2)
    dt = time[:, None] + one.delay_s
    moment = [(weight * dt**power).sum() for power in range(3)]
    determinant = moment[0] * moment[2] - moment[1] ** 2
    fits = determinant > 1e-6 * moment[0] * moment[2]

    def axis(z: Array, position: Array, velocity: Array) -> tuple[Array, Array]:
        first, second = (weight * z).sum(), (weight * dt * z).sum()
        p = safe_divide(moment[2] * first - moment[1] * second, determinant)
        v = safe_divide(moment[0] * second - moment[1] * first, determinant)
        return jnp.where(fits, p, position), jnp.where(fits, v, velocity)

    x, vx = axis(one.x_m, state[0], state[2])
    y, vy = axis(one.y_m, state[1], state[3])
    return jnp.stack([x, y, vx, vy])


def position_information(state: Array, scans: Scan, params: PositionSensor) -> Array:
    """Return what the detections that a trajectory claims tell about it, [4, 4].

        J = Σ_kj r_kj R_kj⁻¹ ⊗ [[1, Δt], [Δt, Δt²]]

    Args:
        state: [4] at the time of the last look.
        scans: K looks stacked.
        params: detection probability, clutter density and noise.
    """
    time, _ = look_times(scans)
    states = propagate(jnp.broadcast_to(state, (time.shape[0], 4)), time)
    claimed = jax.vmap(lambda x, scan: position_responsibility(x, scan, params))(states, scans)
    one = jax.vmap(lambda scan: _detections(scan, params))(scans)
    entries = (one.yy_m2, -one.xy_m2, -one.xy_m2, one.xx_m2)
    inverse = jnp.stack([entry / one.determinant for entry in entries])
    dt = time[:, None] + one.delay_s
    powers = jnp.stack([jnp.ones_like(dt), dt, dt, dt**2])
    both = jnp.einsum("pkn,ikn,kn->pi", powers, inverse, claimed).reshape(2, 2, 2, 2)
    return both.transpose(0, 2, 1, 3).reshape(4, 4)


def blur_position(params: PositionSensor, factor: Array | float) -> PositionSensor:
    """Return a sensor whose noise is wider by a factor, also where a scan has covariances."""
    return params._replace(widening=jnp.asarray(params.widening) * factor)


def check_position_looks(scans: Scan, params: PositionSensor) -> Scan:
    """Return sound looks, [K] stacked, of a sensor that can be.

    Raises:
        TypeError: looks or sensor are not those of positions, or these are not floating numbers.
        ValueError: a shape does not fit, or a known value cannot be.
    """
    scans = check_scans(scans)
    if not isinstance(params, PositionSensor):
        raise TypeError(f"sensor: got a {type(params).__name__}, want a PositionSensor")
    dtype = jnp.result_type(float)
    check_probability("sensor.p_detect", params.p_detect, dtype)
    for name in ("clutter_per_m2", "sigma_m", "widening"):
        check_positive(f"sensor.{name}", getattr(params, name), dtype)
    return scans


POSITION = Observation(
    log_likelihood_ratio=position_log_likelihood_ratio,
    scores=position_scores,
    responsibility=position_responsibility,
    refine=position_refine,
    blur=blur_position,
    positions=lambda scans, params: scans,
    information=position_information,
    check=check_position_looks,
)
"""The observation model of sensors that report positions."""


class Detection(NamedTuple):
    """One detection, or a look of them, ready for the likelihood; amplitude 0 where none stands."""

    x_m: Array
    y_m: Array
    delay_s: Array
    xx_m2: Array  # covariance
    xy_m2: Array
    yy_m2: Array
    determinant: Array
    amplitude: Array  # (P_D/λ) w / 2π√det R


def _detections(scan: Scan, params: PositionSensor) -> Detection:
    counts = scan.mask & scan.valid
    dtype = scan.position_m.dtype
    position = jnp.where(counts[:, None], scan.position_m, 0.0)
    if scan.covariance_m2 is None:
        xx = yy = jnp.full(counts.shape, jnp.asarray(params.sigma_m, dtype) ** 2)
        xy = jnp.zeros_like(xx)
    else:
        unit = jnp.broadcast_to(jnp.eye(2, dtype=dtype), scan.covariance_m2.shape)
        r = jnp.where(counts[:, None, None], scan.covariance_m2, unit)
        xx, xy, yy = r[:, 0, 0], r[:, 0, 1], r[:, 1, 1]
    xx, xy, yy = (x * jnp.asarray(params.widening, dtype) ** 2 for x in (xx, xy, yy))
    determinant = xx * yy - xy**2
    weight = jnp.ones_like(xx) if scan.weight is None else scan.weight
    delay = jnp.zeros_like(xx) if scan.delay_s is None else scan.delay_s
    factor = jnp.asarray(params.p_detect, dtype) / jnp.asarray(params.clutter_per_m2, dtype)
    weight = jnp.where(counts, weight, 0.0)  # here, or NaN behind the mask meets the gradient
    amplitude = factor * weight / (2 * jnp.pi * jnp.sqrt(determinant))
    return Detection(
        position[:, 0],
        position[:, 1],
        jnp.where(counts, delay, 0.0),
        xx,
        xy,
        yy,
        determinant,
        amplitude,
    )


def _ratio(state: Array, dt: Array, one: Detection) -> Array:
    """(P_D/λ) w N(z; H x(t), R) for states [4, …] given dt before the detection's look."""
    after = dt + one.delay_s
    x = one.x_m - (state[0] + state[2] * after)
    y = one.y_m - (state[1] + state[3] * after)
    squared = (one.yy_m2 * x**2 - 2 * one.xy_m2 * x * y + one.xx_m2 * y**2) / one.determinant
    return one.amplitude * jnp.exp(-squared / 2)


def _ratios(state: Array, scan: Scan, params: PositionSensor) -> Array:
    return _ratio(state, jnp.zeros_like(scan.time_s), _detections(scan, params))
