"""What a mechanically scanned sonar is, when and whither it pings, and what its carrier reports.

One narrow beam is turned a step after every ping, to and fro over a sector. See `sensors.pings` for
what it hears.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array, check_size
from jaxtrack.numerics.safe import safe_norm
from jaxtrack.types import Array, Key, Pose


class ScanningSonar(NamedTuple):
    """What the sonar is. Traced; the defaults are the Imagenex 881L's."""

    step_rad: Array | float = math.radians(1.2)
    ping_s: Array | float = 0.06
    range_max_m: Array | float = 40.0
    beam_rad: Array | float = math.radians(1.8)  # Δ, between half powers, across
    beam_up_rad: Array | float = math.radians(20.0)  # Δ', upright
    mount_m: Array | tuple[float, float] = (0.505, 0.0)  # [2] in the body frame
    mount_rad: Array | float = math.radians(-2.7)  # β, where ahead of the sonar looks to
    fluctuation_db: Array | float = 3.0  # σ_F, of an object's level, ping by ping


class PingSizes(NamedTuple):
    """Sizes. Static."""

    pings: int = 101  # of one sweep of the sector
    bins: int = 500
    facets: int = 16  # of a cylinder's arc
    rays: int = 8  # of the beam, where a dike is struck
    shape: int = 3  # ν of the reverberation


class ScanningPreset(NamedTuple):
    """A sonar, and the sizes of its sweeps."""

    sonar: ScanningSonar
    sizes: PingSizes


IMAGENEX_881L = ScanningPreset(ScanningSonar(), PingSizes())
"""675 kHz, 40 m, 120°, steps of 1.2°, a pulse of 110 μs. Zernike moment paper (2023), table 2 and
equation 6; beam widths and the time of a ping are ours."""

_SEAKING = ScanningSonar(math.radians(1.8), 0.075, 50.0, math.radians(3.0), math.radians(20.0),
                         (0.0, 0.0), 0.0)  # fmt: skip
SUPER_SEAKING_LOW = ScanningPreset(_SEAKING, PingSizes(pings=67))
"""325 kHz, 50 m, 119° in steps of 1.8°. Clustering cloud-like model (2019), table 1 and section 4;
the choice among its steps, the bins and the time of a ping are ours."""

SUPER_SEAKING_HIGH = ScanningPreset(
    _SEAKING._replace(
        step_rad=math.radians(0.9),
        ping_s=0.15,
        range_max_m=100.0,
        beam_rad=math.radians(1.5),
        beam_up_rad=math.radians(40.0),
    ),
    PingSizes(pings=134, bins=1000),
)
"""650 kHz, 100 m, 120° in steps of 0.9°. Same source."""


def sweeps(
    sonar: ScanningSonar, *, frames: int, pings: int = 101, dtype: jnp.dtype | None = None
) -> tuple[Array, Array]:
    """Return the time and the bearing of every ping, each [T, Q].

    The beam turns from port to starboard in the first frame, back in the second, and so on, without
    a pause; the sector is symmetric about straight ahead.

    Args:
        sonar: step and time of a ping.
        frames: T sweeps of the sector, static.
        pings: Q of a sweep, static.
        dtype: None: the default one.

    Example:
        >>> time_s, bearing_rad = sweeps(ScanningSonar(), frames=2)
        >>> print(time_s[1, 0].round(2), jnp.rad2deg(bearing_rad[:, [0, -1]]).round(2))
        6.06 [[-60.  60.]
         [ 60. -60.]]

    Source: Zernike moment paper (2023), table 2.
    """
    check_size("frames", frames)
    check_size("pings", pings)
    dtype = jnp.result_type(float) if dtype is None else dtype
    number = jnp.arange(frames * pings).reshape(frames, pings).astype(dtype)
    turn = (jnp.arange(pings).astype(dtype) - (pings - 1) / 2) * jnp.asarray(sonar.step_rad, dtype)
    back = jnp.arange(frames)[:, None] % 2 == 1
    return jnp.asarray(sonar.ping_s, dtype) * number, jnp.where(back, -turn[None], turn[None])


def drifting_pose(key: Key, pose: Pose, share: Array | float) -> Pose:
    """Return what navigation reports of a course: off by a share of the distance run.

        p̂_k = p_k + κ Σ_{j ≤ k} |p_j − p_{j−1}| u,   u a random unit vector

    Args:
        key: of the direction in which it drifts.
        pose: true, position_m [N, 2] in the order of time.
        share: κ, 0.007 in the paper; 0: the pose is exact.

    Example:
        >>> pose = Pose(jnp.stack([jnp.arange(101.0), jnp.zeros(101)], axis=-1), jnp.zeros(101))
        >>> off_m = drifting_pose(jax.random.key(0), pose, 0.007).position_m - pose.position_m
        >>> print(*(f"{x:.3f}" for x in jnp.linalg.norm(off_m, axis=-1)[::50]))
        0.000 0.350 0.700

    Source: Zernike moment paper (2023), section 2.2.1: an error of 0.7 % of the distance.
    """
    check_array("pose.position_m", pose.position_m, shape=("N", 2))
    dtype = pose.position_m.dtype
    steps_m = safe_norm(jnp.diff(pose.position_m, axis=0))
    run_m = jnp.concatenate([jnp.zeros(1, dtype), jnp.cumsum(steps_m)])
    course = 2 * jnp.pi * jax.random.uniform(key, (), dtype)
    unit = jnp.stack([jnp.cos(course), jnp.sin(course)])
    off_m = jnp.asarray(share, dtype) * run_m[:, None] * unit[None]
    return pose._replace(position_m=pose.position_m + off_m)
