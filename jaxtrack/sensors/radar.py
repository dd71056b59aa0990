"""A radar that reports positions: noise, missed detections, Poisson clutter.

    z = H x + v,  v ~ N(0, σ² I),  detected with probability P_D;
    clutter: n ~ Poisson(λ) false detections, uniform over the field.

Source: neutrosophic Hough transform (2018), equation 34 and section V-A.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.models.motion import propagate
from jaxtrack.numerics.checks import check_array, check_known, check_probability, check_size
from jaxtrack.types import Array, Key, Scan, Truth


class Radar(NamedTuple):
    """What the radar does to a scene. Traced."""

    p_detect: Array | float = 0.99
    sigma_m: Array | float = 10.0  # noise of each coordinate
    clutter_per_scan: Array | float = 10.0  # expected false detections a look
    field_low_m: Array | tuple[float, float] = (0.0, 0.0)  # [2] corner of the field
    field_high_m: Array | tuple[float, float] = (3500.0, 1600.0)  # [2] opposite corner


def clutter_per_scan(density_per_km2: Array | float, radar: Radar) -> Array:
    """Return the expected false detections a look for a density a square kilometre.

    Example:
        >>> print(clutter_per_scan(10.0, Radar()))
        56.0
    """
    low, high = jnp.asarray(radar.field_low_m), jnp.asarray(radar.field_high_m)
    return density_per_km2 * (high - low).prod() / 1e6


def move(key: Key, initial: Array, time_s: Array, process_sigma_m_s: Array | float = 0.0) -> Truth:
    """Return straight trajectories, or noisy ones: x' = F x + G w, G = [Δt/2; 1].

    Args:
        key: for the process noise.
        initial: [K, 4] states x, y, vx, vy at the first time.
        time_s: [T] times of the looks.
        process_sigma_m_s: [] standard deviation of the velocity increments w.

    Example:
        >>> truth = move(jax.random.key(0), jnp.array([[0.0, 0.0, 100.0, 0.0]]), jnp.arange(3.0))
        >>> print(truth.state[:, 0, 0])
        [  0. 100. 200.]

    Source: neutrosophic Hough transform (2018), equation 33, in the order x, y, vx, vy.

    Note:
        The paper's w of 10 m/s a look contradicts its constant velocities: off by default.
    """
    check_array("initial", initial, shape=("K", 4))
    check_array("time_s", time_s, shape=("T",))
    noise = jax.random.normal(key, (time_s.shape[0] - 1, initial.shape[0], 2), initial.dtype)

    def step(state: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        dt, w = inputs
        w = w * jnp.asarray(process_sigma_m_s, state.dtype)
        state = propagate(state, dt) + jnp.concatenate([w * dt / 2, w], axis=-1)
        return state, state

    _, later = jax.lax.scan(step, initial, (jnp.diff(time_s), noise))
    state = jnp.concatenate([initial[None], later])
    return Truth(time_s, state, jnp.ones(state.shape[:2], bool))


def observe(key: Key, truth: Truth, radar: Radar, *, detections: int) -> Scan:
    """Return the looks of a radar at a scene, stacked [T], padded to `detections`.

    Targets and clutter stand in random order. Of more clutter than fits beside the targets the
    excess is dropped; `detections` well above K + λ + 5√λ makes that rare beyond notice.

    Args:
        key: random key.
        truth: T looks at K targets.
        radar: what it does.
        detections: size of a look, static.

    Raises:
        ValueError: `detections` is smaller than the number of targets, or a known value of the
            radar cannot be.

    Example:
        >>> truth = move(jax.random.key(0), jnp.array([[900.0, 900.0, 100.0, 0.0]]), jnp.arange(3.0))
        >>> scans = observe(jax.random.key(1), truth, Radar(clutter_per_scan=0.0), detections=4)
        >>> print(scans.position_m.shape)
        (3, 4, 2)

    Source: neutrosophic Hough transform (2018), equation 34.
    """  # noqa: E501
    looks, targets = truth.mask.shape
    check_size("detections", detections, at_least=targets)
    check_probability("radar.p_detect", radar.p_detect, truth.state.dtype)
    amount = lambda x: (x >= 0) & np.isfinite(x)
    check_known("radar.sigma_m", radar.sigma_m, amount, "a number of metres of at least 0")
    check_known("radar.clutter_per_scan", radar.clutter_per_scan, amount, "at least 0 a look")
    dtype = truth.state.dtype
    keys = jax.random.split(key, 5)
    seen = jax.random.uniform(keys[0], truth.mask.shape, dtype)
    seen = truth.mask & (seen < jnp.asarray(radar.p_detect, dtype))
    noise = jax.random.normal(keys[1], (looks, targets, 2), dtype)
    echo = truth.state[..., :2] + jnp.asarray(radar.sigma_m, dtype) * noise

    slots = detections - targets
    expected = jnp.asarray(radar.clutter_per_scan, dtype)
    count = jax.random.poisson(keys[2], expected, (looks,))
    low, high = jnp.asarray(radar.field_low_m, dtype), jnp.asarray(radar.field_high_m, dtype)
    clutter = jax.random.uniform(keys[3], (looks, slots, 2), dtype, low, high)

    mask = jnp.concatenate([seen, jnp.arange(slots)[None, :] < count[:, None]], axis=1)
    position = jnp.concatenate([echo, clutter], axis=1)
    order = jnp.argsort(jax.random.uniform(keys[4], mask.shape, dtype), axis=1)
    shuffled = jnp.take_along_axis(mask, order, axis=1)
    position = jnp.take_along_axis(position, order[..., None], axis=1)
    return Scan(truth.time_s, jnp.ones(looks, bool), position, shuffled)
