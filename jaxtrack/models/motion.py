"""Constant-velocity motion of a state [x, y, vx, vy]."""

import jax.numpy as jnp

from jaxtrack.types import Array, BeamScan, Scan


def propagate(state: Array, dt_s: Array) -> Array:
    """Move constant-velocity states by a time step: p + v·Δt, v.

    Args:
        state: [..., 4] x, y, vx, vy in m and m/s.
        dt_s: scalar, or broadcastable against the leading axes; may be negative.

    Example:
        >>> print(propagate(jnp.array([0.0, 0.0, 2.0, -1.0]), 3.0))
        [ 6. -3.  2. -1.]
    """
    dt = jnp.broadcast_to(jnp.asarray(dt_s, state.dtype), state.shape[:-1])[..., None]
    return jnp.concatenate([state[..., :2] + state[..., 2:] * dt, state[..., 2:]], axis=-1)


def look_times(scans: Scan | BeamScan) -> tuple[Array, Array]:
    """Return the looks' times from the window's end, [K], and the end: the last valid look.

    Looks that never happened stand at the end, whatever their time holds; without any valid look
    the end is 0.

    Example:
        >>> scans = Scan(jnp.array([1.0, 4.0, jnp.nan]), jnp.array([True, True, False]),
        ...              jnp.zeros((3, 1, 2)), jnp.zeros((3, 1), bool))
        >>> times, end = look_times(scans)
        >>> print(times, end)
        [-3.  0.  0.] 4.0
    """
    last = jnp.where(scans.valid, jnp.arange(scans.valid.shape[0]), 0).max()
    end = jnp.where(scans.valid.any(), scans.time_s[last], 0.0)
    return jnp.where(scans.valid, scans.time_s - end, 0.0), end


def transition_matrix(dt_s: Array) -> Array:
    """Return the transition matrix F of `propagate`, [4, 4].

        F = [[I, Δt·I], [0, I]]

    Example:
        >>> print(transition_matrix(jnp.asarray(2.0))[0])
        [1. 0. 2. 0.]

    Source: equation 33 of the neutrosophic Hough transform (2018), in the order x, y, vx, vy.
    """
    dt = jnp.asarray(dt_s)
    eye = jnp.eye(4, dtype=dt.dtype)
    return eye + dt * jnp.eye(4, k=2, dtype=dt.dtype)
