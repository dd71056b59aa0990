"""The unscented Kalman filter: motion and measurement by what they do to a few chosen states."""

from collections.abc import Callable
from typing import NamedTuple

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
from jaxtrack.numerics.definite import rounding_floor, scaled_cholesky
from jaxtrack.types import Array, Estimator


class Spread(NamedTuple):
    """Where the sigma points lie and what they weigh. Traced.

    They lie α √(S + κ) standard deviations out. With α ≪ 1 the weights are huge and of both signs:
    float32 then loses the second differences that they weigh, and the excess need not be positive.
    """

    alpha: Array | float = 1.0
    beta: Array | float = 2.0  # 2 fits a Gaussian's fourth moments
    kappa: Array | float = 0.0


def linearize(
    function: Callable[[Array], Array],
    mean: Array,
    covariance: Array,
    residual: Residual = jnp.subtract,
    spread: Spread | None = None,
) -> Linear:
    """Return the unscented transform of a function, as the straight line that it fits.

        x_i^± = m ± c L_i,   P = L Lᵀ,   c = α √(S + κ),   δ_i^± = f(x_i^±) − f(m)
        value = f(m) + s,   s = Σ_i (δ_i⁺ + δ_i⁻) / 2c²
        matrix = D L⁻¹,   D_i = (δ_i⁺ − δ_i⁻) / 2c
        excess = Σ_i e_i e_iᵀ / 4c² + w₀ s sᵀ,   e_i = δ_i⁺ + δ_i⁻ − 2s,   w₀ = 2 − S/c² − α² + β

    value and matrix P matrixᵀ + excess are the textbook's weighted mean and covariance of the
    points, P matrixᵀ their cross-covariance: the same sums, sorted into odd and even parts. The odd
    part goes through Joseph's form, and the even part is a sum of squares where w₀ ≥ 0.

    Args:
        function: f, state [S] → [Z].
        mean: [S] m.
        covariance: [S, S] P.
        residual: difference of two values of f; with one that wraps angles the mean is taken of
            the differences from f(m), and the value may leave the circle's interval by a little.
        spread: of the points.

    Example:
        The mean of x² is m² + P:

        >>> linear = linearize(lambda x: x**2, jnp.array([3.0]), 4 * jnp.eye(1))
        >>> print(linear.value, linear.matrix, linear.excess)
        [13.] [[6.]] [[32.]]

    Source: E. Wan and R. van der Merwe, The unscented Kalman filter for nonlinear estimation
    (2000), equations 15–19.
    """
    spread = Spread() if spread is None else spread
    size = mean.shape[0]
    alpha, beta, kappa = (jnp.asarray(x, mean.dtype) for x in spread)
    lower, inverse, _ = scaled_cholesky(covariance, floor=rounding_floor(covariance))
    reach = alpha * jnp.sqrt(size + kappa)
    steps = reach * lower.T
    centre = function(mean)
    values = jax.vmap(function)
    difference = jax.vmap(residual, (0, None))
    ahead = difference(values(mean[None, :] + steps), centre)
    behind = difference(values(mean[None, :] - steps), centre)
    even = ahead + behind
    shift = even.sum(0) / (2 * reach**2)
    bend = (even - 2 * shift[None, :]) / (2 * reach)
    weight = 2 - size / reach**2 - alpha**2 + beta
    excess = bend.T @ bend + weight * shift[:, None] * shift[None, :]
    return Linear(centre + shift, ((ahead - behind) / (2 * reach)).T @ inverse, excess)


def predict(
    mean: Array,
    covariance: Array,
    propagate: Callable[[Array], Array],
    noise: Array,
    spread: Spread | None = None,
) -> Moments:
    """Move a state by a motion: mean and covariance of the moved sigma points, plus Q.

    Args:
        mean: [S].
        covariance: [S, S].
        propagate: state [S] → state [S].
        noise: [S, S] Q.
        spread: of the sigma points.

    Example:
        >>> moved = predict(jnp.array([3.0]), 4 * jnp.eye(1), lambda x: x**2, jnp.eye(1))
        >>> print(moved.mean, moved.covariance)
        [13.] [[177.]]
    """
    linear = linearize(propagate, mean, covariance, spread=spread)
    noise = linear.excess + noise
    return Moments(linear.value, predicted_covariance(covariance, linear.matrix, noise))


def update(
    mean: Array,
    covariance: Array,
    measurement: Array,
    measure: Callable[[Array], Array],
    noise: Array,
    residual: Residual = jnp.subtract,
    spread: Spread | None = None,
) -> Update:
    """Take a measurement z = h(x) + noise in: `gaussian.correct` with the transform of h.

    Args:
        mean: [S] predicted.
        covariance: [S, S] predicted.
        measurement: [Z] z.
        measure: h, state [S] → [Z].
        noise: [Z, Z] R.
        residual: difference of two measurements; wraps angles.
        spread: of the sigma points, drawn anew from the predicted density.

    Example:
        >>> after = update(jnp.array([3.0]), jnp.eye(1), jnp.array([9.5]), lambda x: x**2, jnp.eye(1))
        >>> print(after.mean.round(3), after.innovation)
        [2.923] [-0.5]
    """  # noqa: E501
    linear = linearize(measure, mean, covariance, residual, spread)
    innovation = residual(measurement, linear.value)
    return correct(mean, covariance, innovation, linear.matrix, noise + linear.excess)


def unscented(
    params: PolarParams, motion: Motion, spread: Spread | None = None
) -> Estimator[PolarScan, FilterState, FilterInfo]:
    """Return the unscented Kalman filter of one target, seen at most once a look.

    Args:
        params: prior and noise of the sensor.
        motion: of the target, e.g. `models.constant_velocity` or `models.coordinated_turn`.
        spread: of the sigma points.

    Returns:
        An estimator over `PolarScan` with room for one detection; see `gaussian.recursion`. The
        noise in its info holds the transform's excess, so that its smoother is the unscented one.

    Example:
        >>> from jaxtrack.filtering.gaussian import Prior
        >>> from jaxtrack.models import constant_velocity
        >>> from jaxtrack.types import Pose
        >>> prior = Prior(jnp.array([90.0, 0.0, 0.0, 0.0]), 100 * jnp.eye(4))
        >>> filter = unscented(PolarParams(prior, 1.0, 0.01), constant_velocity(0.1))
        >>> scan = PolarScan(jnp.array(0.0), jnp.array(True), jnp.array([100.0]), jnp.array([0.1]),
        ...                  jnp.array([True]), Pose(jnp.zeros(2), jnp.array(0.0)))
        >>> state, info = filter.step(filter.init(jax.random.key(0)), scan)
        >>> print(info.innovation.round(1), state.mean[:2].round(0))
        [9.5 0.1] [99.  9.]
    """
    return polar_filter(params, motion, lambda *density: linearize(*density, spread=spread))
