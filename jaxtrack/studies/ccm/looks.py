"""What associators see in the study `ccm`: drawn echoes of two targets, or a sonar's pings of them.

All sources give looks of one form. Time is counted in looks. Drawn echoes are all seen at once; a
beam that turns to and fro sees a place at bearing α when it gets there, at a time

    t = k + ½ (1 − 1/Q) ± α / (Q Δα),   Q pings a sweep, Δα apart, + in even sweeps k.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.frames import earth_to_polar
from jaxtrack.numerics.safe import safe_divide, safe_norm
from jaxtrack.sensors import (
    SUPER_SEAKING_LOW,
    EchoSensor,
    Situation,
    meeting_pings,
    meeting_targets,
    observe_echoes,
)
from jaxtrack.tracking import detect_in_pings
from jaxtrack.types import Array, Key, Pose, Scan, Truth

LOOKS = 24
ECHOES, CLUTTER = 28, 80  # places in a look
PLACES = 2 * ECHOES + CLUTTER
SOURCES = ("echoes", "pings", "centroids")  # drawn; cells over the threshold; means of clusters
PRESET = SUPER_SEAKING_LOW  # "for a faster scan speed", section 2
CLUSTERS = 32
REACH_M, REACH_RAD = 0.3, 0.06  # three bins; where the beam's pattern has its first zero


class Known(NamedTuple):
    """What associators know of the sensor. Traced."""

    p_detect: Array | float
    echoes: Array | float  # of a detected target
    clutter_per_m2: Array | float
    spread_m: (
        Array | tuple[Array | float, Array | float]
    )  # [2] of an echo about its target, in x and in y


# What sweeps of A and B held on the average, see the study's table of looks.
_KNOWN = {
    "pings": Known(0.99, 4.8, 0.002, (0.61, 0.20)),
    "centroids": Known(0.95, 1.0, 0.0, (0.11, 0.06)),
}


class Looks(NamedTuple):
    """The looks of one run, and what is true of them."""

    truth: Truth  # when each target is seen; velocities in m a look
    scans: Scan  # [T] looks at [N] detections
    origin: Array  # [T, N] int32: the target, −1 of clutter and of empty places
    overflow: Array  # [] a look had more than its places hold
    middle: Array  # [T] when a place straight ahead is seen
    turn_per_rad: Array  # [T] how much later one at a bearing is, looks a radian
    pose: Pose  # [T] of the sonar
    loudest: Array  # [Q, R] of every cell in all sweeps; zero where nothing pings


class Contents(NamedTuple):
    """What the looks of a run held, on the average."""

    detected: Array  # [] share of looks with an echo of a target
    echoes: Array  # [] of a detected target
    echo_squared_m2: Array  # [2] mean square of echoes about their targets, in x and in y
    false_per_look: Array  # []


def known_of(source: str, sensor: EchoSensor) -> Known:
    """Return what associators know of a source's sensor; that of drawn echoes is given.

    Example:
        >>> known_of("echoes", EchoSensor()).spread_m
        (0.5, 0.5)
    """
    if source != "echoes":
        return _KNOWN[source]
    spread_m = sensor.spread_m, sensor.spread_m
    return Known(sensor.p_detect, sensor.echoes, sensor.clutter_per_m2, spread_m)


def looks_of(path: Key, look: Key, situation: Situation, source: Array) -> Looks:
    """Return the looks of one run.

    Args:
        path: key of the paths.
        look: key of the drawn echoes.
        situation: how targets meet; its sensor is that of drawn echoes.
        source: [] place in `SOURCES`. Traced.
    """
    drawn = lambda: _drawn(path, look, situation)
    pinged = lambda: _pinged(path, situation, source == SOURCES.index("centroids"))
    return jax.lax.cond(source == SOURCES.index("echoes"), drawn, pinged)


def seen_at(position_m: Array, middle: Array, turn_per_rad: Array, pose: Pose) -> Array:
    """Return when places are seen in a look, [...]; the other arguments are one look's of `Looks`.

    Args:
        position_m: [..., 2].
        middle: [] and so on.
        turn_per_rad: [].
        pose: of the sonar.
    """
    _, bearing_rad = earth_to_polar(position_m, pose, jnp.asarray(PRESET.sonar.mount_m))
    return middle + turn_per_rad * bearing_rad


def contents(looks: Looks) -> Contents:
    """Return what looks held, averaged over them."""
    dtype = looks.scans.position_m.dtype
    own = looks.origin[:, None, :] == jnp.arange(2, dtype=jnp.int32)[None, :, None]  # [T, 2, N]
    count = own.sum(-1).astype(dtype)
    apart_m = looks.scans.position_m[:, None] - looks.truth.state[:, :, None, :2]
    squares = jnp.where(own[..., None], apart_m**2, 0.0).sum((0, 1, 2))
    seen = (count > 0).astype(dtype)
    false = looks.scans.mask & (looks.origin < 0)
    return Contents(
        seen.mean(),
        safe_divide(count.sum(), seen.sum()),
        safe_divide(squares, count.sum()),
        false.sum(-1).astype(dtype).mean(),
    )


def _drawn(path: Key, look: Key, situation: Situation) -> Looks:
    truth = meeting_targets(path, situation.meeting, looks=LOOKS)
    seen = observe_echoes(look, truth, situation.sensor, echoes=ECHOES, clutter=CLUTTER)
    dtype = truth.state.dtype
    nothing = jnp.zeros(LOOKS, dtype)
    sizes = PRESET.sizes.pings, PRESET.sizes.bins
    pose = Pose(jnp.zeros((LOOKS, 2), dtype), nothing)
    return Looks(truth, *seen, truth.time_s, nothing, pose, jnp.zeros(sizes, dtype))


def _pinged(key: Key, situation: Situation, centroids: Array) -> Looks:
    """Return looks at what stands over the threshold: cells, or means of clusters of them.

    What is near a target in range and bearing is taken for its echo, or the nearer one's: cells do
    not tell whose power they hold.
    """
    sonar, pings = PRESET.sonar, PRESET.sizes.pings
    run = meeting_pings(key, situation.meeting, frames=LOOKS, preset=PRESET)
    detect = lambda sweep: detect_in_pings(sweep, sonar, points=PLACES, clusters=CLUSTERS)
    found, info = jax.lax.map(detect, run.pings)
    spare = ((0, 0), (0, PLACES - CLUSTERS))
    places_m = jnp.pad(found.position_m, (*spare, (0, 0)))
    position_m = jnp.where(centroids, places_m, info.cloud.position_m)
    mask = jnp.where(centroids, jnp.pad(found.mask, spare), info.cloud.mask)

    sweep_s = jnp.asarray(sonar.ping_s, position_m.dtype) * pings
    position, velocity = jnp.split(run.truth.state, 2, axis=-1)
    truth = run.truth._replace(
        time_s=run.truth.time_s / sweep_s,
        state=jnp.concatenate([position, velocity * sweep_s], axis=-1),
    )
    pose = jax.tree.map(lambda x: x[:, 0], run.pings.pose)
    polar = jax.vmap(lambda at, pose: earth_to_polar(at, pose, jnp.asarray(sonar.mount_m)))
    here, there = polar(position_m, pose), polar(position, pose)
    off_m, off_rad = (jnp.abs(x[:, None] - y[:, :, None]) for x, y in zip(here, there, strict=True))
    near = (off_m < REACH_M) & (off_rad < REACH_RAD) & mask[:, None]  # [T, 2, N]
    apart_m = safe_norm(position_m[:, None] - position[:, :, None])
    nearest = jnp.argmin(jnp.where(near, apart_m, jnp.inf), axis=1).astype(jnp.int32)
    origin = jnp.where(near.any(1), nearest, -1)

    looks = jnp.arange(LOOKS).astype(position_m.dtype)
    turn = 1 / (pings * jnp.asarray(sonar.step_rad, position_m.dtype))
    back = jnp.arange(LOOKS) % 2 == 1
    forth = jnp.where(back[:, None, None], run.pings.intensity[:, ::-1], run.pings.intensity)
    return Looks(
        truth,
        Scan(looks, jnp.ones(LOOKS, bool), position_m, mask),
        origin,
        info.overflow.any(),
        looks + (1 - 1 / pings) / 2,
        jnp.where(back, -turn, turn),
        pose,
        forth.max(axis=0),
    )
