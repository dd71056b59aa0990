"""A sonar's looks at straight targets, for tests of window estimators: one false alarm a look."""

import jax
import jax.numpy as jnp

from jaxtrack.types import Scan

# Table 2 of the clustering-statistic Hough transform: n, e, v_n, v_e.
TABLE_2 = ((10.0, 80.0, 1.0, 4.0), (20.0, 30.0, -2.0, 1.0), (50.0, 60.0, 3.0, -3.0))
SLOTS = 8


def beam_looks(key, targets=TABLE_2, *, p_false=0.3, p_miss=0.3, sigma_m=3.0, looks=20):
    """Return a Scan of `looks` looks 0.5 s apart, and the states at the last one, [M, 4].

    The sonar moves from (−10, −10) with (0.5, 0.5) m/s, heading 45°; bearings are those of the
    beams of 1°, ranges have noise. A look has at most one false alarm.
    """
    dtype = jnp.zeros(()).dtype
    state = jnp.asarray(targets, dtype)
    time = jnp.arange(looks).astype(dtype) * 0.5
    own = -10.0 + 0.5 * time[:, None] * jnp.ones((1, 2), dtype)
    at = state[None, :, :2] + time[:, None, None] * state[None, :, 2:]
    apart = at - own[:, None]
    distance = jnp.sqrt((apart**2).sum(-1))
    bearing = jnp.arctan2(apart[..., 1], apart[..., 0]) - jnp.pi / 4
    degree = jnp.pi / 180
    beam = jnp.floor(bearing / degree)
    seen, noise, alarm, place, angle = jax.random.split(key, 5)
    shape = distance.shape
    visible = (beam >= -45) & (beam < 45) & (distance < 150.0)
    hit = visible & (jax.random.uniform(seen, shape, dtype) >= p_miss)
    distance = distance + sigma_m * jax.random.normal(noise, shape, dtype)
    false = jax.random.uniform(alarm, (looks, 1), dtype) < p_false
    far = 150.0 * jax.random.uniform(place, (looks, 1), dtype)
    other = jax.random.randint(angle, (looks, 1), -45, 45).astype(dtype)
    distance = jnp.concatenate([distance, far], axis=1)
    direction = (jnp.concatenate([beam, other], axis=1) + 0.5) * degree + jnp.pi / 4
    position = jnp.stack([jnp.cos(direction), jnp.sin(direction)], -1) * distance[..., None]
    position = position + own[:, None]
    spare = SLOTS - state.shape[0] - 1
    scans = Scan(
        time_s=time,
        valid=jnp.ones(looks, bool),
        position_m=jnp.pad(position, ((0, 0), (0, spare), (0, 0))),
        mask=jnp.pad(jnp.concatenate([hit, false], axis=1), ((0, 0), (0, spare))),
    )
    return scans, jnp.concatenate([at[-1], state[:, 2:]], axis=-1)
