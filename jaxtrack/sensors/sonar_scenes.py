"""Scenes for a forward-looking sonar on a moving vehicle: the paper's two, and random ones.

x is north, y is east; headings turn clockwise from north.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.frames import polar_to_earth
from jaxtrack.models.motion import propagate
from jaxtrack.models.sonar import BeamSonar
from jaxtrack.numerics.checks import check_choice, check_size
from jaxtrack.sensors.sonar import in_sight
from jaxtrack.types import Array, Key, Pose, Truth

TRUTHS = ("table", "visible")

_TABLE_2 = ((10.0, 80.0, 1.0, 4.0), (20.0, 30.0, -2.0, 1.0), (50.0, 60.0, 3.0, -3.0))
_TABLE_7 = (
    (120.0, 80.0, -0.5, -1.0),
    (20.0, 0.0, 2.0, 0.25),
    (70.0, -10.0, -0.25, 1.5),
    (200.0, 20.0, -1.5, 0.5),
    (120.0, 150.0, 0.25, -0.75),
)
_TABLE_7_SPANS_S = ((1.0, 69.0), (1.0, 100.0), (1.0, 59.0), (22.0, 88.0), (32.0, 100.0))

_DRAWS = 16


class SonarScene(NamedTuple):
    """What is there, where the vehicle is, and the sonar it carries."""

    truth: Truth
    pose: Pose  # position_m [T, 2], heading_rad [T]
    sonar: BeamSonar


def motion_elements_scene() -> SonarScene:
    """Return the paper's three targets, in sight throughout one window of 20 looks, 0.5 s apart.

    The vehicle moves at (0.5, 0.5) m/s and looks where it goes, 45° from north. P_M = P_F = 0.3,
    σ = 3 m; other rates by `scene.sonar._replace`.

    Example:
        >>> scene = motion_elements_scene()
        >>> print(scene.truth.state.shape, scene.pose.position_m[-1])
        (20, 3, 4) [-5.25 -5.25]

    Source: clustering-statistic Hough transform (2018), table 2 and section V-A.
    """
    dtype = jnp.result_type(float)
    time_s = 0.5 * jnp.arange(20, dtype=dtype)
    truth = _straight(_TABLE_2, time_s)
    pose = _course((-10.0, -10.0, 0.5, 0.5), math.pi / 4, time_s)
    return SonarScene(truth, pose, BeamSonar())


def tracking_scene(truth: str = "table") -> SonarScene:
    """Return the paper's five targets that appear and disappear, from 1 to 100 s, 0.5 s apart.

    The vehicle moves at (0.87, 0.5) m/s and looks where it goes, 30° from north. P_M = P_F = 0.5,
    σ = 3 m. Initial positions are those at time 0.

    Args:
        truth: when a target counts as there. `"table"`: between the moments that table 7 prints.
            `"visible"`: while the sonar's scope and sector hold it. The two agree on births, but
            for target 5, which comes into range at 31.5 s and in the table at 32 s. Targets 1, 3
            and 4 are last in the sector at 60, 52 and 82 s, where the table has them disappear at
            69, 59 and 88 s: against the table a tracker that knows its field of view is charged
            for targets nobody can see. The echoes are the same, that one look of target 5 apart.

    Raises:
        ValueError: an unknown truth.

    Example:
        >>> print(tracking_scene("table").truth.mask.sum(axis=0))
        [137 199 117 133 137]
        >>> print(tracking_scene("visible").truth.mask.sum(axis=0))
        [119 199 103 121 138]

    Source: clustering-statistic Hough transform (2018), table 7 and section V-B.
    """
    check_choice("truth", truth, TRUTHS)
    dtype = jnp.result_type(float)
    time_s = 0.5 * jnp.arange(2, 201, dtype=dtype)
    targets = _straight(_TABLE_7, time_s)
    pose = _course((0.0, 0.0, 0.87, 0.5), math.pi / 6, time_s)
    sonar = BeamSonar(p_miss=0.5, p_false=0.5)
    if truth == "visible":
        return SonarScene(in_sight(targets, pose, sonar), pose, sonar)
    born_s, gone_s = jnp.asarray(_TABLE_7_SPANS_S, dtype).T
    there = (time_s[:, None] >= born_s[None]) & (time_s[:, None] <= gone_s[None])
    return SonarScene(targets._replace(mask=there), pose, sonar)


class SonarSceneLimits(NamedTuple):
    """What random scenes keep to. Written down before any method saw one. Traced."""

    v_min_m_s: Array | float = 0.5
    v_max_m_s: Array | float = 6.0
    range_min_m: Array | float = 10.0  # at mid-window
    seen_share: Array | float = 0.75  # of the looks in which each target is in sight, 15 of 20
    apart_beams: Array | float = 3.0  # at mid-window two targets' bearings differ by this …
    apart_sigmas: Array | float = 5.0  # … or their ranges by this many σ
    vehicle_v_max_m_s: Array | float = 1.5
    vehicle_turn_max_rad_s: Array | float = 0.02
    vehicle_field_m: Array | float = 100.0  # at mid-window it is this near the origin, on each axis


def random_sonar_scene(
    key: Key,
    sonar: BeamSonar,
    limits: SonarSceneLimits,
    *,
    targets: int,
    count: Array | int | None = None,
    looks: int = 20,
    dt_s: float = 0.5,
    beams: int = 90,
) -> tuple[SonarScene, Array]:
    """Return straight targets before a turning vehicle, and whether they keep to every limit.

    The limits, with their defaults: each target moves at 0.5 to 6 m/s, stands 10 m off or more at
    mid-window, and is in sight in at least 15 of 20 looks; at mid-window any two differ by at least
    3 beams in bearing or 5 σ in range. The vehicle moves ahead at up to 1.5 m/s and turns at up to
    0.02 rad/s.

    At mid-window the vehicle's heading is uniform over the circle and the targets' positions are
    uniform over the sector's area, their courses over the circle; speeds are uniform. The first of
    16 draws that is seen long enough is taken for each target. A scene that breaks a limit is
    returned all the same, with the flag down, so that studies can report such scenes apart. Rates
    are the sonar's; the scene carries it on.

    Args:
        key: random key.
        sonar: whose scope, sector, mounting and σ count.
        limits: what to keep to.
        targets: how many at most, static.
        count: [] how many there are, traced; the rest are masked out. None: all.
        looks: how many, static.
        dt_s: time between looks.
        beams: of the sonar, static.

    Example:
        >>> draw = jax.vmap(lambda key: random_sonar_scene(
        ...     key, BeamSonar(), SonarSceneLimits(), targets=3))
        >>> scenes, within = draw(jax.random.split(jax.random.key(0), 200))
        >>> print(scenes.truth.state.shape, 0.85 < within.mean() < 1.0)
        (200, 20, 3, 4) True
    """
    check_size("targets", targets)
    check_size("looks", looks)
    check_size("beams", beams)
    dtype = jnp.result_type(float)
    time_s = jnp.asarray(dt_s, dtype) * jnp.arange(looks, dtype=dtype)
    middle_s = time_s[-1] / 2
    draws, moves = jax.random.split(key)
    pose, middle = _vehicle(moves, limits, time_s - middle_s)
    sector = jnp.asarray(sonar.sector_rad, dtype)
    nearest, farthest = (jnp.asarray(x, dtype) for x in (limits.range_min_m, sonar.range_max_m))
    slowest, fastest = (jnp.asarray(x, dtype) for x in (limits.v_min_m_s, limits.v_max_m_s))

    def target(key: Key) -> tuple[Array, Array, Array, Array]:
        share = jax.random.uniform(key, (4, _DRAWS), dtype)
        bearing = sector * (share[0] - 0.5)
        range_m = jnp.sqrt(nearest**2 + share[1] * (farthest**2 - nearest**2))
        position = polar_to_earth(range_m, bearing, middle, sonar.mount_m)
        course, speed = 2 * jnp.pi * share[2], slowest + share[3] * (fastest - slowest)
        velocity = speed[:, None] * jnp.stack([jnp.cos(course), jnp.sin(course)], axis=-1)
        state = jnp.concatenate([position - middle_s * velocity, velocity], axis=-1)
        seen = in_sight(_path(state, time_s), pose, sonar).mask.astype(dtype).mean(axis=0)
        fits = seen >= jnp.asarray(limits.seen_share, dtype)
        first = jnp.argmax(fits)
        return state[first], bearing[first], range_m[first], fits[first]

    state, bearing, range_m, fits = jax.vmap(target)(jax.random.split(draws, targets))
    truth = _path(state, time_s)
    here = jnp.arange(targets) < (targets if count is None else count)
    apart_rad = jnp.asarray(limits.apart_beams, dtype) * sector / beams
    apart_m = jnp.asarray(limits.apart_sigmas, dtype) * jnp.asarray(sonar.sigma_m, dtype)
    apart = jnp.abs(bearing[:, None] - bearing[None, :]) >= apart_rad
    apart |= jnp.abs(range_m[:, None] - range_m[None, :]) >= apart_m
    no_pair = jnp.eye(targets, dtype=bool) | ~here[:, None] | ~here[None, :]
    truth = truth._replace(mask=truth.mask & here[None])
    within = (fits | ~here).all() & (apart | no_pair).all()
    return SonarScene(truth, pose, sonar), within


def _vehicle(key: Key, limits: SonarSceneLimits, after_s: Array) -> tuple[Pose, Pose]:
    """Return poses on an arc, [T], and the one at its middle."""
    dtype = after_s.dtype
    field, speed, turn = (
        jnp.asarray(x, dtype)
        for x in (limits.vehicle_field_m, limits.vehicle_v_max_m_s, limits.vehicle_turn_max_rad_s)
    )
    share = jax.random.uniform(key, (5,), dtype)
    place = field * (2 * share[:2] - 1)
    heading, turn, speed = 2 * jnp.pi * share[2], turn * (2 * share[3] - 1), speed * share[4]
    # An arc's chord is sin(ωt/2) / (ωt/2) of its length, and points half the turn on.
    chord = speed * after_s * jnp.sinc(turn * after_s / (2 * jnp.pi))
    half = heading + turn * after_s / 2
    unit = jnp.stack([jnp.cos(half), jnp.sin(half)], axis=-1)
    pose = Pose(place[None] + chord[:, None] * unit, heading + turn * after_s)
    return pose, Pose(place, heading)


def _path(initial: Array, time_s: Array) -> Truth:
    state = jax.vmap(propagate, (None, 0))(initial, time_s)
    return Truth(time_s, state, jnp.ones(state.shape[:2], bool))


def _straight(initial: tuple[tuple[float, ...], ...], time_s: Array) -> Truth:
    return _path(jnp.asarray(initial, time_s.dtype), time_s)


def _course(initial: tuple[float, ...], heading_rad: float, time_s: Array) -> Pose:
    state = _straight((initial,), time_s).state[:, 0]
    return Pose(state[:, :2], jnp.full_like(time_s, heading_rad))
