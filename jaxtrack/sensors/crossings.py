"""Two targets that meet, each with several echoes a look, in uniform clutter.

n ~ 1 + Poisson(λ − 1) echoes of a detected target,  z = H x + v,  v ~ N(0, s² I);
clutter: Poisson(β A) false detections, uniform over the field of area A.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.models.motion import propagate
from jaxtrack.numerics.checks import (
    check_array,
    check_known,
    check_probability,
    check_size,
)
from jaxtrack.types import Array, Key, Scan, Truth

FIELD_M = 35.0
MEETING_M = (19.0, 27.0)
MEETING_LOOK = 12
SPEED_M_S = 1.25
_UNIT_S = 1.0  # between looks: the paper counts steps


class Meeting(NamedTuple):
    """How two targets meet. Traced."""

    angle_rad: Array | float  # between their courses; 0: side by side
    gap_m: Array | float = 0.0  # between them where they meet, across their mean course
    sigma_a_m_s2: Array | float = 0.05  # white-noise acceleration of each coordinate


class EchoSensor(NamedTuple):
    """A sensor that sees several echoes of a target. Traced."""

    p_detect: Array | float = 0.9
    echoes: Array | float = 4.0  # λ ≥ 1, expected number of a detected target
    spread_m: Array | float = 0.5  # s, of each coordinate about the target
    clutter_per_m2: Array | float = 0.0  # β


class Situation(NamedTuple):
    """A meeting, and the sensor that looks at it."""

    meeting: Meeting
    sensor: EchoSensor


class EchoLooks(NamedTuple):
    """What a sensor saw."""

    scans: Scan  # [T] looks
    origin: Array  # [T, N] int32: the target, −1 of clutter and of empty places
    overflow: Array  # [] echoes or clutter did not fit; the excess is dropped


def situations() -> dict[str, Situation]:
    """Return the six situations of the experiment by name.

    A: side by side, 8 m apart; A3: 3 m. B: crossing at 60°; C: in clutter; D: at 30°; E: one echo.

    Example:
        >>> print(*situations())
        A A3 B C D E

    Source: the experiment of the readings of the clustering cloud-like model (2019), section 4 of
        which gives the two kinds of paths, the field and the 24 steps, but no numbers of noise.
    """
    degrees = jnp.pi / 180
    clutter = EchoSensor(clutter_per_m2=0.02)
    return {
        "A": Situation(Meeting(0.0, 8.0, 0.02), EchoSensor()),
        "A3": Situation(Meeting(0.0, 3.0, 0.02), EchoSensor()),
        "B": Situation(Meeting(60 * degrees), EchoSensor()),
        "C": Situation(Meeting(60 * degrees), clutter),
        "D": Situation(Meeting(30 * degrees), clutter),
        "E": Situation(Meeting(30 * degrees), clutter._replace(echoes=1.0)),
    }


def meeting_targets(key: Key, meeting: Meeting, *, looks: int = 24) -> Truth:
    """Return two targets at 1.25 m a step, from left to right, that meet at (19, 27) m in look 12.

    The first comes from below and goes up, the second comes from above. In look 12 both stand at
    the meeting point, or half of the gap below and above it, on the courses asked for: the
    accelerations bend their ways to it and away from it, but do not make them miss each other.

    Args:
        key: of the accelerations.
        meeting: angle, gap and noise.
        looks: how many, a second apart, static.

    Example:
        >>> truth = meeting_targets(jax.random.key(0), Meeting(0.0, 8.0, 0.0))
        >>> print(truth.state[12].round(2))
        [[19.   23.    1.25  0.  ]
         [19.   31.    1.25  0.  ]]

    Source: clustering cloud-like model (2019), section 4.
    """
    check_size("looks", looks, at_least=2)
    dtype = jnp.result_type(float)
    half = jnp.asarray(meeting.angle_rad, dtype) / 2
    side = jnp.asarray([1.0, -1.0], dtype)
    course = jnp.stack([jnp.cos(half * side), jnp.sin(half * side)], axis=-1)
    velocity = SPEED_M_S * course
    gap = jnp.asarray(meeting.gap_m, dtype) / 2 * side
    meet = jnp.asarray(MEETING_M, dtype)[None] - jnp.stack([0 * gap, gap], axis=-1)
    steps = max(looks - 1, MEETING_LOOK)
    sigma = jnp.asarray(meeting.sigma_a_m_s2, dtype)
    push = sigma * jax.random.normal(key, (steps, 2, 2), dtype)

    def step(bend: Array, push: Array) -> tuple[Array, Array]:
        kick = jnp.concatenate([push * _UNIT_S**2 / 2, push * _UNIT_S], axis=-1)
        bend = propagate(bend, jnp.asarray(_UNIT_S, dtype)) + kick
        return bend, bend

    # The bends add to a straight way, and so does what takes them back where the targets meet.
    straight = jnp.zeros((2, 4), dtype)
    _, later = jax.lax.scan(step, straight, push)
    bend = jnp.concatenate([straight[None], later])
    time_s = _UNIT_S * (jnp.arange(steps + 1) - MEETING_LOOK).astype(dtype)
    there = jnp.concatenate([meet, velocity], axis=-1)
    state = jax.vmap(propagate, (None, 0))(there - bend[MEETING_LOOK], time_s) + bend
    time_s = _UNIT_S * jnp.arange(looks).astype(dtype)
    return Truth(time_s, state[:looks], jnp.ones((looks, 2), bool))


def observe_echoes(
    key: Key, truth: Truth, sensor: EchoSensor, *, echoes: int, clutter: int
) -> EchoLooks:
    """Return the looks of a sensor with several echoes a target, in random order.

    Args:
        key: random key.
        truth: T looks at K targets.
        sensor: rates and spread.
        echoes: places for echoes of a target, static; λ + 6√λ or more.
        clutter: places for clutter, static; likewise.

    Raises:
        ValueError: a size below one, or a known value of the sensor that cannot be.

    Example:
        >>> truth = meeting_targets(jax.random.key(0), Meeting(0.0, 8.0))
        >>> seen = observe_echoes(jax.random.key(1), truth, EchoSensor(), echoes=16, clutter=8)
        >>> print(seen.scans.position_m.shape, seen.overflow)
        (24, 40, 2) False

    Source: the experiment of the readings of the clustering cloud-like model (2019).
    """
    check_array("truth.state", truth.state, shape=("T", "K", 4))
    check_size("echoes", echoes)
    check_size("clutter", clutter)
    check_probability("sensor.p_detect", sensor.p_detect, truth.state.dtype)
    some = lambda x: (x >= 1) & np.isfinite(x)
    check_known("sensor.echoes", sensor.echoes, some, "at least one echo")
    for name in ("spread_m", "clutter_per_m2"):
        amount = lambda x: (x >= 0) & np.isfinite(x)
        check_known(f"sensor.{name}", getattr(sensor, name), amount, "a number of at least 0")
    dtype = truth.state.dtype
    looks, targets = truth.mask.shape
    keys = jax.random.split(key, 6)
    seen = jax.random.uniform(keys[0], truth.mask.shape, dtype) < jnp.asarray(sensor.p_detect)
    rate = jnp.asarray(sensor.echoes, dtype) - 1
    count = 1 + jax.random.poisson(keys[1], jnp.where(rate > 0, rate, 0.0), truth.mask.shape)
    count = jnp.where(seen & truth.mask, count, 0)
    noise = jax.random.normal(keys[2], (looks, targets, echoes, 2), dtype)
    echo = truth.state[:, :, None, :2] + jnp.asarray(sensor.spread_m, dtype) * noise
    number = jax.random.poisson(
        keys[3], jnp.asarray(sensor.clutter_per_m2, dtype) * FIELD_M**2, (looks,)
    )
    false = FIELD_M * jax.random.uniform(keys[4], (looks, clutter, 2), dtype)

    own = jnp.arange(echoes)[None, None, :] < count[..., None]
    whose = jnp.broadcast_to(jnp.arange(targets, dtype=jnp.int32)[None, :, None], own.shape)
    flat = lambda x: x.reshape(looks, targets * echoes, *x.shape[3:])
    mask = jnp.concatenate([flat(own), jnp.arange(clutter)[None, :] < number[:, None]], axis=1)
    position = jnp.concatenate([flat(echo), false], axis=1)
    nobody = jnp.full((looks, clutter), -1, jnp.int32)
    origin = jnp.concatenate([flat(jnp.where(own, whose, -1)), nobody], axis=1)
    order = jnp.argsort(jax.random.uniform(keys[5], mask.shape, dtype), axis=1)
    mask, origin = (jnp.take_along_axis(x, order, axis=1) for x in (mask, origin))
    position = jnp.take_along_axis(position, order[..., None], axis=1)
    scans = Scan(truth.time_s, jnp.ones(looks, bool), position, mask)
    return EchoLooks(scans, origin, (count > echoes).any() | (number > clutter).any())
