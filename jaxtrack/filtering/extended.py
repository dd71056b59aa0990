"""The extended Kalman filter: motion and measurement by their tangent at the mean."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxtrack.filtering.gaussian import (
    FilterInfo,
    FilterState,
    Linear,
    Moments,
    Update,
    correct,
    predicted_covariance,
)
from jaxtrack.filtering.polar import PolarParams, Residual, polar_filter
from jaxtrack.models.process import Motion
from jaxtrack.models.range_bearing import PolarScan
from jaxtrack.types import Array, Estimator


def linearize(
    function: Callable[[Array], Array],
    mean: Array,
    covariance: Array,
    residual: Residual = jnp.subtract,
) -> Linear:
    """Return a function's tangent at the mean: f(m), ∂f/∂x(m), and no excess.

    Covariance and residual are not needed; they make it of one form with `unscented.linearize`.

    Example:
        >>> linear = linearize(lambda x: x**2, jnp.array([3.0]), jnp.eye(1))
        >>> print(linear.value, linear.matrix)
        [9.] [[6.]]
    """
    matrix, value = jax.jacfwd(lambda x: (function(x),) * 2, has_aux=True)(mean)
    return Linear(value, matrix, jnp.zeros((value.shape[0],) * 2, value.dtype))


def predict(
    mean: Array, covariance: Array, propagate: Callable[[Array], Array], noise: Array
) -> Moments:
    """Move a state by a motion.

        m⁻ = f(m),   P⁻ = F P Fᵀ + Q,   F = ∂f/∂x(m)

    Args:
        mean: [S].
        covariance: [S, S].
        propagate: f, state [S] → state [S].
        noise: [S, S] Q.

    Example:
        >>> moved = predict(jnp.array([3.0]), jnp.eye(1), lambda x: x**2, jnp.eye(1))
        >>> print(moved.mean, moved.covariance)
        [9.] [[37.]]
    """
    linear = linearize(propagate, mean, covariance)
    return Moments(linear.value, predicted_covariance(covariance, linear.matrix, noise))


def update(
    mean: Array,
    covariance: Array,
    measurement: Array,
    measure: Callable[[Array], Array],
    noise: Array,
    residual: Residual = jnp.subtract,
) -> Update:
    """Take a measurement z = h(x) + noise in: `gaussian.correct` with H = ∂h/∂x(m).

    Args:
        mean: [S] predicted.
        covariance: [S, S] predicted.
        measurement: [Z] z.
        measure: h, state [S] → [Z].
        noise: [Z, Z] R.
        residual: (z, h(m)) → innovation [Z]; wraps angles.

    Example:
        >>> after = update(jnp.array([3.0]), jnp.eye(1), jnp.array([9.5]), lambda x: x**2, jnp.eye(1))
        >>> print(after.mean.round(3), after.innovation)
        [3.081] [0.5]
    """  # noqa: E501
    linear = linearize(measure, mean, covariance)
    return correct(mean, covariance, residual(measurement, linear.value), linear.matrix, noise)


def extended(params: PolarParams, motion: Motion) -> Estimator[PolarScan, FilterState, FilterInfo]:
    """Return the extended Kalman filter of one target, seen at most once a look.

    Args:
        params: prior and noise of the sensor.
        motion: of the target, e.g. `models.constant_velocity` or `models.coordinated_turn`.

    Returns:
        An estimator over `PolarScan` with room for one detection; see `gaussian.recursion`.

    Example:
        >>> from jaxtrack.filtering.gaussian import Prior
        >>> from jaxtrack.models import constant_velocity
        >>> from jaxtrack.types import Pose
        >>> prior = Prior(jnp.array([90.0, 0.0, 0.0, 0.0]), 100 * jnp.eye(4))
        >>> filter = extended(PolarParams(prior, 1.0, 0.01), constant_velocity(0.1))
        >>> scan = PolarScan(jnp.array(0.0), jnp.array(True), jnp.array([100.0]), jnp.array([0.1]),
        ...                  jnp.array([True]), Pose(jnp.zeros(2), jnp.array(0.0)))
        >>> state, info = filter.step(filter.init(jax.random.key(0)), scan)
        >>> print(info.innovation.round(3), state.mean[:2].round(0))
        [10.   0.1] [100.   9.]
    """
    return polar_filter(params, motion, linearize)
