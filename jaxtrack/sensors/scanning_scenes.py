"""Scenes for a mechanically scanned sonar: a bucket that is dragged along, and targets that meet.

A bucket hangs in the water before the vehicle; a rubber boat drags it towards a dike in the west,
or lies still. x is north, y is east; headings turn clockwise from north.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.frames import earth_to_polar
from jaxtrack.numerics.checks import check_array, check_choice, check_mask, check_size
from jaxtrack.sensors.crossings import Meeting, meeting_targets
from jaxtrack.sensors.pings import Cylinders, Dike, observe_pings
from jaxtrack.sensors.scanning_sonar import (
    IMAGENEX_881L,
    SUPER_SEAKING_LOW,
    ScanningPreset,
    ScanningSonar,
    drifting_pose,
    sweeps,
)
from jaxtrack.types import Array, Key, Pings, Pose, Truth

MOTIONS = ("static", "hovering", "following")
SURROUNDINGS = ("clean", "two_objects")

_WEST = -math.pi / 2
_BUCKET = (0.39, 35.0, 0.5)  # radius, level, depth below the sonar
_OTHER = (0.3, 33.0, 0.0)
_BOAT = (0.6, 38.0, -1.5)
_REFLECTOR = (0.025, 35.0, 0.0)
_SWAY_M, _YAW_RAD, _WANDER_RAD = 0.2, math.radians(2.0), math.radians(12.0)


class PingRun(NamedTuple):
    """One run: what the sonar heard, where the vehicle was, and where the targets were."""

    pings: Pings  # [T] sweeps of [Q] pings; their pose is the one that navigation reports
    pose: Pose  # the true one, position_m [T, Q, 2], heading_rad [T, Q]
    truth: Truth  # T sweeps, by their first ping's time; states are those when the beam crosses
    crossing_s: Array  # [T, K] the time of the ping whose beam is nearest to the target


class DraggedBucket(NamedTuple):
    """What the scenes of the bucket have. Traced."""

    speed_m_s: Array | float = 0.1  # of a target that moves
    range_m: Array | float = 10.0  # of the target at first, give or take a tenth
    clutter_m: Array | float = 2.0  # from the target's mean path, or place, to objects beside it
    dike_m: Array | float = 38.0  # west of where the vehicle is at first
    drift: Array | float = 0.0  # of the reported pose, a share of the distance run; paper: 0.007


def dragged_bucket(
    key: Key,
    motion: str,
    surroundings: str = "clean",
    *,
    scene: DraggedBucket | None = None,
    there: Array | None = None,
    frames: int = 30,
    preset: ScanningPreset = IMAGENEX_881L,
) -> PingRun:
    """Return a run of the experiments with a bucket of 0.78 m before a vehicle that looks west.

    The course of a target that moves winds about a mean one, within 20° of west. The boat is 6 m
    ahead of it. A hovering vehicle sways by some decimetres and yaws by some degrees; a following
    one does so while it moves on as the target does on average. Other objects stand on either side
    of the path at one and two thirds of its length, or, of a target at rest, on either side of it.

    Args:
        key: random key.
        motion: `"static"` target and hovering vehicle, `"hovering"` vehicle and moving target, or
            `"following"` vehicle.
        surroundings: `"clean"`, or `"two_objects"` near the target's path.
        scene: speeds, distances and the drift of the reported pose; the defaults if None.
        there: [T] whether the target is in the water, sweep by sweep; None: always.
        frames: T sweeps, static.
        preset: the sonar, and the sizes of its sweeps, static.

    Returns:
        A run of one target. Its truth is masked out in sweeps that cannot meet it.

    Raises:
        ValueError: an unknown word, or a shape that does not fit.

    Example:
        >>> run = dragged_bucket(jax.random.key(0), "hovering", "two_objects", frames=3)
        >>> print(run.pings.intensity.shape, run.truth.state.shape, run.truth.mask.all())
        (3, 101, 500) (3, 1, 4) True

    Source: Zernike moment paper (2023), section 3: the three experiments, the bucket and 0.1 m/s;
        the distances, the levels and the other objects are ours.
    """
    check_choice("motion", motion, MOTIONS)
    check_choice("surroundings", surroundings, SURROUNDINGS)
    scene = DraggedBucket() if scene is None else scene
    dtype = jnp.result_type(float)
    keys = jax.random.split(key, 5)
    time_s, bearing_rad = sweeps(preset.sonar, frames=frames, pings=preset.sizes.pings, dtype=dtype)
    now_s = time_s.ravel()
    moves = 0.0 if motion == "static" else 1.0
    speed = moves * jnp.asarray(scene.speed_m_s, dtype)

    share = jax.random.uniform(keys[0], (4,), dtype, -1.0, 1.0)
    mean_rad = _WEST + math.radians(20.0) * share[0]
    course_rad = mean_rad + _WANDER_RAD * _waves(keys[1], now_s, 1, (40.0, 120.0))[:, 0]
    velocity = speed * _unit(course_rad)
    step_s = jnp.diff(now_s, append=now_s[-1:] + jnp.asarray(preset.sonar.ping_s, dtype))
    run_m = jnp.cumsum(velocity * step_s[:, None], axis=0) - velocity * step_s[:, None]
    far_m = jnp.asarray(scene.range_m, dtype) * (1 + 0.1 * share[1])
    start_m = far_m * _unit(_WEST + math.radians(15.0) * share[2])
    target_m = start_m[None] + run_m

    sway = _waves(keys[2], now_s, 3, (20.0, 90.0))
    follows = speed * now_s if motion == "following" else 0 * now_s
    place_m = _SWAY_M * (sway[:, :2] - sway[:1, :2]) + follows[:, None] * _unit(mean_rad)[None]
    pose = Pose(place_m, _WEST + _YAW_RAD * sway[:, 2])

    boat_m = target_m + 6.0 * _unit(course_rad)
    kinds = [_BUCKET, _BOAT]
    places = [target_m, boat_m]
    if surroundings == "two_objects":
        length_m = speed * now_s[-1]
        aside = jnp.asarray(scene.clutter_m, dtype) * _unit(mean_rad + math.pi / 2)
        along = _unit(mean_rad)
        for side, third in ((1.0, 1 / 3), (-1.0, 2 / 3)):
            at_m = start_m + third * length_m * along + side * aside
            places.append(jnp.broadcast_to(at_m[None], target_m.shape))
            kinds.append(_OTHER)
    position_m = jnp.stack(places, axis=1)
    mask = jnp.ones(position_m.shape[:2], bool)
    here = jnp.ones(frames, bool) if there is None else there
    check_mask("there", here, shape=(frames,))
    mask = mask.at[:, 0].set(jnp.repeat(here, preset.sizes.pings))
    dike = Dike(jnp.asarray(scene.dike_m, dtype), _WEST)
    cylinders = Cylinders(position_m, mask, *jnp.asarray(kinds, dtype).T)
    reported = drifting_pose(keys[3], pose, scene.drift)
    state = jnp.concatenate([target_m, velocity], axis=-1)[:, None]
    return _run(keys[4], time_s, bearing_rad, pose, reported, cylinders, state, dike, preset)


def meeting_pings(
    key: Key,
    meeting: Meeting,
    *,
    frames: int = 24,
    preset: ScanningPreset = SUPER_SEAKING_LOW,
) -> PingRun:
    """Return two small reflectors that meet, as `meeting_targets` has them, a sweep a step.

    The vehicle stands at (17.5, 0) m and looks along y; between two steps targets move evenly.

    Args:
        key: random key.
        meeting: how they meet.
        frames: T sweeps, static.
        preset: the sonar, and the sizes of its sweeps, static.

    Example:
        >>> run = meeting_pings(jax.random.key(0), Meeting(0.0, 8.0), frames=3)
        >>> print(run.pings.intensity.shape, run.truth.state.shape)
        (3, 67, 500) (3, 2, 4)

    Source: clustering cloud-like model (2019), section 4; see `sensors.crossings`.
    """
    check_size("frames", frames)
    keys = jax.random.split(key)
    # A step more, for the targets to move on in the last sweep.
    steps = meeting_targets(keys[0], meeting, looks=frames + 1).state
    dtype = steps.dtype
    pings = preset.sizes.pings
    time_s, bearing_rad = sweeps(preset.sonar, frames=frames, pings=pings, dtype=dtype)
    share = (jnp.arange(pings).astype(dtype) / pings)[None, :, None, None]
    here, there = steps[:-1, None, :, :2], steps[1:, None, :, :2]
    position_m = here + share * (there - here)
    frame_s = jnp.asarray(preset.sonar.ping_s, dtype) * pings
    velocity = jnp.broadcast_to((there - here) / frame_s, position_m.shape)
    flat = lambda x: x.reshape(-1, *x.shape[2:])
    state = flat(jnp.concatenate([position_m, velocity], axis=-1))
    stand = jnp.broadcast_to(jnp.asarray([17.5, 0.0], dtype), (frames * pings, 2))
    pose = Pose(stand, jnp.full(frames * pings, math.pi / 2, dtype))
    kinds = jnp.asarray([_REFLECTOR] * 2, dtype).T
    cylinders = Cylinders(state[..., :2], jnp.ones(state.shape[:2], bool), *kinds)
    return _run(keys[1], time_s, bearing_rad, pose, pose, cylinders, state, None, preset)


def beam_crossing(
    position_m: Array, bearing_rad: Array, pose: Pose, sonar: ScanningSonar
) -> tuple[Array, Array]:
    """Return the ping whose beam is nearest to a target, [], and whether it meets it, [].

    It meets a target within a step of its axis and within the scope.

    Args:
        position_m: [Q, 2] of the target at every ping.
        bearing_rad: [Q] of the beam.
        pose: the carrier's true one, at every ping.
        sonar: its mounting, scope and step.

    Example:
        >>> sonar = ScanningSonar(mount_m=(0.0, 0.0), mount_rad=0.0)
        >>> bearing_rad = sweeps(sonar, frames=1)[1][0]
        >>> pose = Pose(jnp.zeros((101, 2)), jnp.zeros(101))
        >>> ahead_m = jnp.tile(jnp.array([8.0, 0.0]), (101, 1))
        >>> print(*beam_crossing(ahead_m, bearing_rad, pose, sonar))
        50 True
    """
    check_array("position_m", position_m, shape=(bearing_rad.shape[0], 2))
    dtype = position_m.dtype
    polar = jax.vmap(earth_to_polar, (0, 0, None))
    range_m, seen_rad = polar(position_m, pose, jnp.asarray(sonar.mount_m, dtype))
    turn = seen_rad - bearing_rad - jnp.asarray(sonar.mount_rad, dtype)
    off_rad = jnp.abs(jnp.arctan2(jnp.sin(turn), jnp.cos(turn)))
    ping = jnp.argmin(off_rad)
    meets = off_rad[ping] <= jnp.asarray(sonar.step_rad, dtype)
    return ping, meets & (range_m[ping] <= jnp.asarray(sonar.range_max_m, dtype))


def _run(
    key: Key,
    time_s: Array,
    bearing_rad: Array,
    pose: Pose,
    reported: Pose,
    cylinders: Cylinders,
    state: Array,
    dike: Dike | None,
    preset: ScanningPreset,
) -> PingRun:
    """Return a run of T sweeps of Q pings from T · Q poses, places and states [T · Q, K, 4].

    The targets are the first K cylinders.
    """
    frames, pings = time_s.shape
    apart = lambda x: x.reshape(frames, pings, *x.shape[1:])
    framed = lambda pose: Pose(apart(pose.position_m), apart(pose.heading_rad))
    true, state = framed(pose), apart(state)
    kinds = (cylinders.radius_m, cylinders.level_db, cylinders.depth_m)

    def frame(one: tuple[Array, ...]) -> Array:
        key, time_s, bearing_rad, position_m, mask, *at = one
        now = Cylinders(position_m, mask, *kinds)
        options = {"dike": dike, "sizes": preset.sizes}
        seen = observe_pings(key, time_s, bearing_rad, Pose(*at), now, preset.sonar, **options)
        return seen.intensity

    # A loop, for one frame's draws stay in the cache and all frames' would not.
    keys = jax.random.split(key, frames)
    places = apart(cylinders.position_m), apart(cylinders.mask)
    intensity = jax.lax.map(frame, (keys, time_s, bearing_rad, *places, *true))
    one = lambda place, bearing, *at: beam_crossing(place, bearing, Pose(*at), preset.sonar)
    over_targets = jax.vmap(one, (1, None, None, None))
    targets = state.shape[2]
    ping, meets = jax.vmap(over_targets)(state[..., :2], bearing_rad, *true)  # [T, K]
    at = jnp.take_along_axis(state, ping[:, None, :, None], axis=1)[:, 0]
    here = jnp.take_along_axis(places[1][:, :, :targets], ping[:, None], axis=1)[:, 0]
    when_s = jnp.take_along_axis(time_s, ping, axis=1)
    seen = Pings(time_s, bearing_rad, intensity, jnp.ones((frames, pings), bool), framed(reported))
    return PingRun(seen, true, Truth(time_s[:, 0], at, meets & here), when_s)


def _waves(key: Key, time_s: Array, count: int, periods_s: tuple[float, float]) -> Array:
    """Return sums of three sines each, of unit mean square and random periods, [N, count]."""
    keys = jax.random.split(key)
    short, long = periods_s
    period_s = jax.random.uniform(keys[0], (3, count), time_s.dtype, short, long)
    phase = 2 * jnp.pi * jax.random.uniform(keys[1], (3, count), time_s.dtype)
    turn = 2 * jnp.pi * time_s[:, None, None] / period_s[None] + phase[None]
    return math.sqrt(2 / 3) * jnp.sin(turn).sum(axis=1)


def _unit(angle_rad: Array) -> Array:
    return jnp.stack([jnp.cos(angle_rad), jnp.sin(angle_rad)], axis=-1)
