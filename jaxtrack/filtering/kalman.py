"""The Kalman filter: linear motion, linear measurement.

`predict` and `update` are its two steps on arrays; `kalman` is the filter of one target with
constant velocity, seen at most once a look as a position.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.filtering.gaussian import (
    FilterInfo,
    FilterState,
    Linear,
    Prior,
    Seen,
    Update,
    correct,
    predict,
    recursion,
)
from jaxtrack.models.motion import propagate, transition_matrix
from jaxtrack.models.process import white_noise_acceleration
from jaxtrack.numerics.checks import check_array
from jaxtrack.types import Array, Estimator, Scan

__all__ = ["KalmanParams", "kalman", "position_seen", "predict", "update"]


class KalmanParams(NamedTuple):
    """What the filter knows of target and sensor. Traced."""

    prior: Prior  # of [x, y, vx, vy]
    sigma_a_m_s2: Array | float  # [] white-noise acceleration of each coordinate
    sigma_m: Array | float  # [] noise of each coordinate, where a scan has no covariance of its own


def update(
    mean: Array, covariance: Array, measurement: Array, matrix: Array, noise: Array
) -> Update:
    """Take a linear measurement z = H x + noise in, in Joseph's form: see `gaussian.correct`.

    Args:
        mean: [S] predicted.
        covariance: [S, S] predicted.
        measurement: [Z] z.
        matrix: [Z, S] H.
        noise: [Z, Z] R.

    Raises:
        ValueError: shapes do not fit together.

    Example:
        >>> after = update(jnp.ones(1), jnp.eye(1), 2 * jnp.ones(1), jnp.eye(1), 3 * jnp.eye(1))
        >>> print(after.mean, after.covariance)
        [1.25] [[0.75]]
    """
    check_array("matrix", matrix, shape=(*jnp.shape(measurement), *jnp.shape(mean)))
    return correct(mean, covariance, measurement - matrix @ mean, matrix, noise)


def position_seen(mean: Array, scan: Scan, sigma_m: Array | float) -> Seen:
    """Return what a look of a position sensor says of its one target.

        H = [I, δI, 0],   R = R_scan / w

    Args:
        mean: [S] predicted, begins with x, y, vx, vy.
        scan: one look with room for one detection; its own covariance, weight w and delay δ count.
        sigma_m: [] noise of each coordinate where the scan has no covariance.

    Raises:
        ValueError: the scan has not exactly one place for a detection.

    Example:
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.ones((1, 2)), jnp.array([True]))
        >>> seen = position_seen(jnp.zeros(4), scan, 10.0)
        >>> print(seen.innovation, seen.noise[0])
        [1. 1.] [100.   0.]

    Note:
        A detection of weight w is one whose likelihood is raised to the power w. Of the motion
        between a look's time and its detection's, the process noise is left out.
    """
    check_array("scan.position_m", scan.position_m, shape=(1, 2))
    dtype = mean.dtype
    unit, zero, one = jnp.eye(2, dtype=dtype), jnp.zeros((), dtype), jnp.ones((), dtype)
    seen = scan.valid & scan.mask[0]
    weight = one if scan.weight is None else jnp.where(seen, scan.weight[0], one)
    seen = seen & (weight > 0)
    delay = zero if scan.delay_s is None else jnp.where(seen, scan.delay_s[0], zero)
    if scan.covariance_m2 is None:
        noise = jnp.asarray(sigma_m, dtype) ** 2 * unit
    else:
        noise = jnp.where(seen, scan.covariance_m2[0], unit)
    rest = jnp.zeros((2, mean.shape[0] - 4), dtype)
    matrix = jnp.concatenate([unit, delay * unit, rest], axis=1)
    position = jnp.where(seen, scan.position_m[0], 0.0)
    innovation = jnp.where(seen, position - matrix @ mean, 0.0)
    return Seen(seen, innovation, matrix, noise / jnp.where(seen, weight, one))


def kalman(params: KalmanParams) -> Estimator[Scan, FilterState, FilterInfo]:
    """Return the Kalman filter of one target with constant velocity, seen at most once a look.

    Args:
        params: prior, acceleration and noise of the sensor.

    Returns:
        An estimator over `Scan` with room for one detection; see `gaussian.recursion` for looks
        that are missed or are none, and `position_seen` for what of a scan counts.

    Example:
        >>> import jax
        >>> filter = kalman(KalmanParams(Prior(jnp.zeros(4), 1e4 * jnp.eye(4)), 0.01, 1.0))
        >>> t = jnp.arange(1.0, 21.0)
        >>> at = jnp.stack([3 * t, 50 - t], axis=-1)[:, None]
        >>> scans = Scan(t, jnp.ones(20, bool), at, jnp.ones((20, 1), bool))
        >>> state, info = jax.lax.scan(filter.step, filter.init(jax.random.key(0)), scans)
        >>> print(state.mean.round(1))
        [60. 30.  3. -1.]

    Source: clustering-statistic Hough transform (2018), section V-B, for motion and noise.
    """

    def move(mean: Array, covariance: Array, dt_s: Array) -> Linear:
        noise = white_noise_acceleration(dt_s, params.sigma_a_m_s2)
        return Linear(propagate(mean, dt_s), transition_matrix(dt_s), noise)

    def observe(mean: Array, covariance: Array, scan: Scan) -> Seen:
        return position_seen(mean, scan, params.sigma_m)

    check_array("params.prior.mean", params.prior.mean, shape=(4,))
    return recursion(params.prior, move, observe)
