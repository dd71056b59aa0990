"""What `kalman_tracker` asks of the filters of its tracks, and the Kalman filter as an answer.

    scan ─look─► positions ─start─► beliefs of new tracks
    beliefs ─predict─► beliefs ─measure─► Predicted ─► associate ─update─► beliefs ─moments─► Tracks

A belief is whatever a filter keeps of one target; tables of beliefs have the tracks in front. The
steps are those of the filters of one target (`filtering`): with one target and no clutter a tracker
is its filter.
"""

from collections.abc import Callable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from jaxtrack.association import Association, Predicted, Update, predict_measurement
from jaxtrack.filtering import extended
from jaxtrack.filtering.gaussian import Linear, Moments, predicted_covariance
from jaxtrack.filtering.polar import Linearize
from jaxtrack.models import Motion, constant_velocity, propagate, white_noise_acceleration
from jaxtrack.numerics.checks import check_array, check_positive
from jaxtrack.types import Array, Scan

BeliefT = TypeVar("BeliefT")


class Filter(NamedTuple, Generic[BeliefT]):
    """A filter, for tables of tracks. Functions only; traced numbers reach them by closure."""

    look: Callable[[Any], Scan]  # a look as positions, in which tracks start
    start: Callable[[Scan], BeliefT]  # beliefs [N, …] of tracks that start at its detections
    predict: Callable[[BeliefT, Array], BeliefT]  # (beliefs, dt_s)
    measure: Callable[[BeliefT, Any, Array], Predicted]  # (beliefs, scan, mask [T])
    update: Callable[[BeliefT, Predicted, Scan, Association, Update], BeliefT]
    moments: Callable[[BeliefT], Moments]  # [T, S], [T, S, S], x, y, vx, vy first


def position_filter(
    motion: Motion,
    sigma_m: Array | float,
    birth_sigma: Array | Sequence[Array | float],
    *,
    birth_sigma_m: Array | float | None = None,
    linearize: Linearize = extended.linearize,
) -> Filter[Moments]:
    """Return the Kalman filter of targets that are seen as positions.

    Args:
        motion: of the targets, with states of S entries.
        sigma_m: [] noise of each coordinate, where a scan has no covariances.
        birth_sigma: [S − 2] deviations of what a new track's detection does not tell: velocity in
            m/s, and of a turning motion the rate in rad/s.
        birth_sigma_m: [] deviation of its position; None: the detection's noise.
        linearize: of a motion that is not straight, as in `extended` or `unscented`.

    Raises:
        ValueError: a known number that cannot be.

    Example:
        >>> from jaxtrack.models import coordinated_turn
        >>> filter = position_filter(coordinated_turn(0.1, 0.01), 1.0, (3.0, 3.0, 0.1))
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.ones((1, 2)), jnp.ones(1, bool))
        >>> print(jnp.diagonal(filter.start(scan).covariance[0]).round(2))
        [1.   1.   9.   9.   0.01]
    """
    check_sigmas(sigma_m=sigma_m, birth_sigma_m=birth_sigma_m)

    def start(look: Scan) -> Moments:
        return at_rest(look, sigma_m, birth_sigma, birth_sigma_m)

    def measure(beliefs: Moments, scan: Scan, mask: Array) -> Predicted:
        return predict_measurement(*beliefs, noise_of_positions(sigma_m, scan), mask)

    return Filter(as_it_is, start, moving(motion, linearize), measure, learn, as_it_is)


def straight_filter(
    sigma_m: Array | float,
    sigma_a_m_s2: Array | float,
    birth_sigma_m_s: Array | float,
    birth_sigma_m: Array | float | None = None,
) -> Filter[Moments]:
    """Return `position_filter` of constant velocity, its prediction without matrix products.

        F = I + Δt N,   F P Fᵀ + Q,   N P: the rows of the velocity in place of the position's

    Args:
        sigma_m: [] noise of each coordinate, where a scan has no covariances.
        sigma_a_m_s2: [] white-noise acceleration of each coordinate.
        birth_sigma_m_s: [] of each coordinate of a new track's velocity.
        birth_sigma_m: [] of its position; None: the detection's noise.

    Raises:
        ValueError: a known number that cannot be.

    Example:
        >>> filter = straight_filter(1.0, 0.1, 3.0)
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.ones((1, 2)), jnp.ones(1, bool))
        >>> later = filter.predict(filter.start(scan), jnp.array(2.0))
        >>> print(jnp.diagonal(later.covariance[0]).round(2))
        [37.04 37.04  9.04  9.04]
    """
    check_array("birth_sigma_m_s", birth_sigma_m_s, shape=())
    motion, speeds = constant_velocity(sigma_a_m_s2), (birth_sigma_m_s, birth_sigma_m_s)
    filter = position_filter(motion, sigma_m, speeds, birth_sigma_m=birth_sigma_m)

    def predict(beliefs: Moments, dt_s: Array) -> Moments:
        p, noise = beliefs.covariance, white_noise_acceleration(dt_s, sigma_a_m_s2)
        p = p + dt_s * jnp.pad(p[:, 2:], ((0, 0), (0, 2), (0, 0)))
        p = p + dt_s * jnp.pad(p[:, :, 2:], ((0, 0), (0, 0), (0, 2)))
        p = (p + jnp.swapaxes(p, 1, 2)) / 2 + noise[None]
        return Moments(propagate(beliefs.mean, dt_s), p)

    return filter._replace(predict=predict)


def as_it_is(x: Any) -> Any:
    """Return what it is given: a scan of positions is its own look, moments are their own."""
    return x


def learn(
    beliefs: Moments, predicted: Predicted, look: Scan, found: Association, update: Update
) -> Moments:
    """Return moments updated by the associator's own update."""
    return Moments(*update(*beliefs, predicted, look, found))


def moving(motion: Motion, linearize: Linearize) -> Callable[[Moments, Array], Moments]:
    """Return the prediction of a table by a motion near each density."""

    def one(belief: Moments, dt_s: Array) -> Moments:
        forward = lambda state: motion.propagate(state, dt_s)
        linear: Linear = linearize(forward, *belief, jnp.subtract)
        noise = linear.excess + motion.noise(dt_s)
        wider = predicted_covariance(belief.covariance, linear.matrix, noise)
        return Moments(linear.value, wider)

    return jax.vmap(one, (0, None))


def at_rest(
    look: Scan,
    sigma_m: Array | float,
    birth_sigma: Array | Sequence[Array | float],
    birth_sigma_m: Array | float | None,
) -> Moments:
    """Return the density of a track at each detection: all of its state but the place around 0."""
    dtype = look.position_m.dtype
    there = look.mask & look.valid
    rest = jnp.stack([jnp.asarray(x, dtype) ** 2 for x in birth_sigma])
    position = jnp.where(there[:, None], look.position_m, 0.0)
    if birth_sigma_m is not None:
        spread = noise_of_positions(birth_sigma_m, look)[None]
    else:
        spread = noise_of_positions(sigma_m, look)[None]
        if look.covariance_m2 is not None:
            spread = jnp.where(there[:, None, None], look.covariance_m2, spread)
    size = rest.shape[0]
    spread = jnp.broadcast_to(spread, (there.shape[0], 2, 2))
    covariance = jnp.pad(spread, ((0, 0), (0, size), (0, size)))
    covariance = covariance + jnp.diag(jnp.pad(rest, (2, 0)))[None]
    return Moments(jnp.pad(position, ((0, 0), (0, size))), covariance)


def noise_of_positions(sigma_m: Array | float, scan: Scan) -> Array:
    """Return R = σ² I, [2, 2], in the scan's precision.

    Example:
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.ones((1, 2)), jnp.ones(1, bool))
        >>> print(noise_of_positions(3.0, scan)[0])
        [9. 0.]
    """
    dtype = scan.position_m.dtype
    return jnp.asarray(sigma_m, dtype) ** 2 * jnp.eye(2, dtype=dtype)


def check_sigmas(**sigmas: Array | float | None) -> None:
    """Check that deviations are positive, those that are known.

    Raises:
        ValueError: one is not a scalar, or not positive.

    Example:
        >>> check_sigmas(sigma_m=1.0, birth_sigma_m=None)
    """
    for name, value in sigmas.items():
        if value is not None:
            check_array(name, value, shape=())
            check_positive(name, value, jnp.result_type(float))
