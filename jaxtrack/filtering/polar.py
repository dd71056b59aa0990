"""A target seen in range and bearing: what the extended and the unscented filter share."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.filtering.gaussian import FilterInfo, FilterState, Linear, Prior, Seen, recursion
from jaxtrack.models.process import Motion
from jaxtrack.models.range_bearing import PolarScan, range_bearing, range_bearing_residual
from jaxtrack.numerics.checks import check_array
from jaxtrack.types import Array, Estimator

Residual = Callable[[Array, Array], Array]
"""(measured, expected) → measured − expected, its angles wrapped."""

Linearize = Callable[[Callable[[Array], Array], Array, Array, Residual], Linear]
"""(function, mean, covariance, residual) → the function near that density."""


class PolarParams(NamedTuple):
    """What a filter knows of target and sensor. Traced."""

    prior: Prior  # of the motion's state
    sigma_range_m: Array | float  # [] where a scan has no covariance of its own
    sigma_bearing_rad: Array | float  # []
    mount_m: Array | tuple[float, float] = (0.0, 0.0)  # [2] of the sensor in the body frame


def polar_filter(
    params: PolarParams, motion: Motion, linearize: Linearize
) -> Estimator[PolarScan, FilterState, FilterInfo]:
    """Return the filter of one target seen at most once a look, given how to make it linear.

    Args:
        params: prior and noise of the sensor.
        motion: of the target.
        linearize: as in `extended.linearize`.

    Example:
        >>> from jaxtrack.filtering import extended
        >>> from jaxtrack.models import constant_velocity
        >>> params = PolarParams(Prior(jnp.zeros(4), jnp.eye(4)), 1.0, 0.01)
        >>> filter = polar_filter(params, constant_velocity(0.1), extended.linearize)
        >>> print(filter.init(jax.random.key(0)).mean)
        [0. 0. 0. 0.]
    """

    def move(mean: Array, covariance: Array, dt_s: Array) -> Linear:
        forward = lambda state: motion.propagate(state, dt_s)
        linear = linearize(forward, mean, covariance, jnp.subtract)
        return linear._replace(excess=linear.excess + motion.noise(dt_s))

    def observe(mean: Array, covariance: Array, scan: PolarScan) -> Seen:
        check_array("scan.range_m", scan.range_m, shape=(1,))
        check_array("scan.bearing_rad", scan.bearing_rad, shape=(1,))
        seen = scan.valid & scan.mask[0]
        clean = lambda x: jnp.where(seen, x, 0.0)
        pose = jax.tree.map(clean, scan.pose)
        linear = linearize(
            lambda state: range_bearing(state, pose, params.mount_m),
            mean,
            covariance,
            range_bearing_residual,
        )
        measured = clean(jnp.stack([scan.range_m[0], scan.bearing_rad[0]]))
        innovation = clean(range_bearing_residual(measured, linear.value))
        if scan.covariance is None:
            sigmas = (params.sigma_range_m, params.sigma_bearing_rad)
            noise = jnp.diag(jnp.stack([jnp.asarray(s, mean.dtype) ** 2 for s in sigmas]))
        else:
            noise = jnp.where(seen, scan.covariance[0], jnp.eye(2, dtype=mean.dtype))
        return Seen(seen, innovation, linear.matrix, noise + linear.excess)

    return recursion(params.prior, move, observe)
