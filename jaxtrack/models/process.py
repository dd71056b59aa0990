"""Motion with noise: straight lines under white-noise acceleration, and coordinated turns.

A `Motion` is what a filter asks of a target: where a state goes, and how uncertain that is. States
begin with x, y, vx, vy; that of a turn goes on with the turn rate ω, positive from x towards y
(clockwise where x is north and y east).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxtrack.models.motion import propagate
from jaxtrack.numerics.safe import as_float, safe_sinc
from jaxtrack.types import Array


class Motion(NamedTuple):
    """How a target moves in a time step. Functions of one state; rebuilt where their noise is traced."""  # noqa: E501

    propagate: Callable[[Array, Array], Array]  # (state [S], dt_s []) -> state [S]
    noise: Callable[[Array], Array]  # (dt_s []) -> covariance [S, S]


def white_noise_acceleration(dt_s: ArrayLike, sigma_a_m_s2: ArrayLike) -> Array:
    """Return the process noise of an acceleration that is constant in a step and new in the next.

        Q = σ² [[Δt⁴/4, Δt³/2], [Δt³/2, Δt²]] ⊗ I₂,   [4, 4]

    Args:
        dt_s: [] Δt.
        sigma_a_m_s2: [] σ of each coordinate of the acceleration.

    Example:
        >>> print(white_noise_acceleration(2.0, 0.5)[0])
        [1. 0. 1. 0.]

    Note:
        Two steps are not one step of twice the length: the acceleration is redrawn between them.
    """
    dt = as_float(dt_s)
    gain = jnp.stack([dt**2 / 2, dt])
    block = jnp.asarray(sigma_a_m_s2, dt.dtype) ** 2 * gain[:, None] * gain[None, :]
    return jnp.kron(block, jnp.eye(2, dtype=dt.dtype))


def turn(state: Array, dt_s: ArrayLike) -> Array:
    """Move a state along a circle, at constant speed and turn rate.

        p' = p + Δt sin(u/2)/(u/2) R(u/2) v,   v' = R(u) v,   u = ω Δt,
        R(u) = [[cos u, −sin u], [sin u, cos u]]:  the chord points half as far round as the turn

    Args:
        state: [5] x, y, vx, vy, ω in m, m/s and rad/s; ω = 0 is a straight line.
        dt_s: [] may be negative.

    Example:
        A quarter of a turn, first north, then east:

        >>> print(turn(jnp.array([0.0, 0.0, jnp.pi / 2, 0.0, jnp.pi / 2]), 1.0).round(1) + 0.0)
        [1.  1.  0.  1.6 1.6]
    """
    x, y, vx, vy, rate = (state[k] for k in range(5))
    dt = jnp.asarray(dt_s, state.dtype)
    half = rate * dt / 2
    cos_half, sin_half, chord = jnp.cos(half), jnp.sin(half), dt * safe_sinc(half)
    cos, sin = 1 - 2 * sin_half**2, 2 * sin_half * cos_half
    return jnp.stack(
        [
            x + chord * (cos_half * vx - sin_half * vy),
            y + chord * (sin_half * vx + cos_half * vy),
            cos * vx - sin * vy,
            sin * vx + cos * vy,
            rate,
        ]
    )


def turn_noise(dt_s: ArrayLike, sigma_a_m_s2: ArrayLike, sigma_turn_rad_s2: ArrayLike) -> Array:
    """Return the process noise of `turn`: white accelerations, along the plane and of the turn.

        Q = blockdiag(Q_a, σ_ω² Δt²),   [5, 5],   with Q_a of `white_noise_acceleration`

    Args:
        dt_s: [] Δt.
        sigma_a_m_s2: [] of each coordinate of the acceleration.
        sigma_turn_rad_s2: [] σ_ω, of the turn rate's change in a second.

    Example:
        >>> print(jnp.diagonal(turn_noise(2.0, 0.5, 0.25)))
        [1.   1.   1.   1.   0.25]
    """
    dt = as_float(dt_s)
    return _join(
        white_noise_acceleration(dt, sigma_a_m_s2),
        (jnp.asarray(sigma_turn_rad_s2, dt.dtype) * dt) ** 2,
    )


def constant_velocity(sigma_a_m_s2: ArrayLike) -> Motion:
    """Return straight motion of [x, y, vx, vy] under white-noise acceleration.

    Args:
        sigma_a_m_s2: [] of each coordinate of the acceleration.

    Example:
        >>> motion = constant_velocity(0.5)
        >>> print(motion.propagate(jnp.array([0.0, 0.0, 2.0, -1.0]), jnp.asarray(3.0)))
        [ 6. -3.  2. -1.]
    """
    return Motion(propagate, lambda dt_s: white_noise_acceleration(dt_s, sigma_a_m_s2))


def straight(sigma_a_m_s2: ArrayLike, sigma_turn_rad_s: ArrayLike) -> Motion:
    """Return straight motion of [x, y, vx, vy, ω], to stand beside a turn in one set of models.

    A straight line has no turn rate. What stands in its place is what a turn that begins now would
    have: N(0, σ_T²), whatever it was before, so that it neither drifts nor drives the position.

    Args:
        sigma_a_m_s2: [] of each coordinate of the acceleration.
        sigma_turn_rad_s: [] σ_T, the turn rate that a beginning turn is expected to have.

    Example:
        >>> motion = straight(0.5, 0.1)
        >>> print(motion.propagate(jnp.array([0.0, 0.0, 2.0, -1.0, 0.3]), jnp.asarray(3.0)))
        [ 6. -3.  2. -1.  0.]
    """

    def move(state: Array, dt_s: Array) -> Array:
        return jnp.concatenate([propagate(state[:4], dt_s), jnp.zeros_like(state[4:])])

    def noise(dt_s: Array) -> Array:
        dt = as_float(dt_s)
        variance = jnp.asarray(sigma_turn_rad_s, dt.dtype) ** 2
        return _join(white_noise_acceleration(dt, sigma_a_m_s2), variance)

    return Motion(move, noise)


def coordinated_turn(sigma_a_m_s2: ArrayLike, sigma_turn_rad_s2: ArrayLike) -> Motion:
    """Return the coordinated turn of [x, y, vx, vy, ω].

    Args:
        sigma_a_m_s2: [] of each coordinate of the acceleration.
        sigma_turn_rad_s2: [] of the turn rate's change in a second.

    Example:
        >>> motion = coordinated_turn(0.5, 0.1)
        >>> print(motion.noise(jnp.asarray(1.0)).shape)
        (5, 5)
    """
    return Motion(turn, lambda dt_s: turn_noise(dt_s, sigma_a_m_s2, sigma_turn_rad_s2))


def _join(plane: Array, turn_variance: Array) -> Array:
    """Append the variance of the turn rate to a covariance of the plane, [5, 5]."""
    last = jnp.arange(5) == 4
    return jnp.where(last[:, None] & last[None, :], turn_variance, jnp.pad(plane, (0, 1)))
