"""What one look says about a target in a given state.

A target at x is detected with probability P_D, its position blurred by R, in Poisson clutter of
density λ. The log-likelihood ratio of the look against clutter alone is then

    log[ 1 − P_D + (P_D / λ) Σ_j w_j N(z_j; H x(t_j), R_j) ].

Any function of this signature (`jaxtrack.types.LogLikelihoodRatio`) plugs into `hough.joint`.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.types import Array, Scan


class PositionSensor(NamedTuple):
    """What a position sensor's likelihood needs."""

    p_detect: Array | float  # [] probability that a target is detected in a look
    clutter_per_m2: Array | float  # [] λ, expected false detections a square metre and look
    sigma_m: Array | float  # [] noise of each coordinate, where a scan has no covariance of its own


def position_log_likelihood_ratio(state: Array, scan: Scan, sensor: PositionSensor) -> Array:
    """Return log p(look | target at state) − log p(look | no target), in nats.

    Args:
        state: [4] x, y, vx, vy at the look's time.
        scan: one look; its weights multiply the densities, its delays move the state.
        sensor: detection probability, clutter density and noise.

    Returns:
        A scalar; 0 for an invalid look, log(1 − P_D) for a valid one without detections.

    Example:
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.zeros((1, 2)), jnp.array([True]))
        >>> sensor = PositionSensor(p_detect=0.9, clutter_per_m2=1e-5, sigma_m=10.0)
        >>> print(position_log_likelihood_ratio(jnp.zeros(4), scan, sensor).round(2))
        4.97

    Source: density form of equation 47's per-look events; readings in `docs/design.md`.
    """
    total = _detection_ratio(state, scan, sensor).sum()
    ratio = jnp.log(1 - jnp.asarray(sensor.p_detect, state.dtype) + total)
    return jnp.where(scan.valid, ratio, 0.0)


def position_responsibility(state: Array, scan: Scan, sensor: PositionSensor) -> Array:
    """Return the posterior probability that each detection is the target's, [N].

        r_j = (P_D/λ) w_j N_j / (1 − P_D + (P_D/λ) Σ_i w_i N_i)

    Args:
        state: [4] x, y, vx, vy at the look's time.
        scan: one look.
        sensor: as in `position_log_likelihood_ratio`.

    Example:
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.zeros((1, 2)), jnp.array([True]))
        >>> sensor = PositionSensor(p_detect=0.9, clutter_per_m2=1e-5, sigma_m=10.0)
        >>> print(position_responsibility(jnp.zeros(4), scan, sensor).round(3))
        [0.999]
    """
    ratio = _detection_ratio(state, scan, sensor)
    return ratio / (1 - jnp.asarray(sensor.p_detect, state.dtype) + ratio.sum())


def _detection_ratio(state: Array, scan: Scan, sensor: PositionSensor) -> Array:
    """(P_D/λ) w_j N(z_j; H x(t_j), R_j), zero where there is no detection. [N]."""
    counts = scan.mask & scan.valid
    expected = jnp.broadcast_to(state[:2], scan.position_m.shape)
    if scan.delay_s is not None:
        expected = expected + jnp.where(counts, scan.delay_s, 0.0)[:, None] * state[2:]
    residual = jnp.where(counts[:, None], scan.position_m, 0.0) - expected
    if scan.covariance_m2 is None:
        variance = jnp.asarray(sensor.sigma_m, state.dtype) ** 2
        squared = (residual**2).sum(-1) / variance
        determinant = variance**2
    else:
        unit = jnp.eye(2, dtype=state.dtype)
        r = jnp.where(counts[:, None, None], scan.covariance_m2, unit)
        determinant = r[:, 0, 0] * r[:, 1, 1] - r[:, 0, 1] ** 2
        x, y = residual[:, 0], residual[:, 1]
        squared = (r[:, 1, 1] * x**2 - 2 * r[:, 0, 1] * x * y + r[:, 0, 0] * y**2) / determinant
    density = jnp.exp(-squared / 2) / (2 * jnp.pi * jnp.sqrt(determinant))
    weight = 1.0 if scan.weight is None else jnp.where(counts, scan.weight, 0.0)
    factor = jnp.asarray(sensor.p_detect, state.dtype) / jnp.asarray(
        sensor.clutter_per_m2, state.dtype
    )
    return jnp.where(counts, factor * weight * density, 0.0)
