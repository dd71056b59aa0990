"""Scenes for track initiation: the paper's, its real radar measurements, and random ones."""

import csv
from importlib import resources
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.models.line import line_difference, line_through
from jaxtrack.numerics.checks import check_choice, check_size
from jaxtrack.sensors.radar import Radar, move
from jaxtrack.types import Array, Key, Truth

SITUATIONS = ("I", "II", "III", "IV")


class Scene(NamedTuple):
    """What is there, and the radar that looks at it."""

    truth: Truth
    radar: Radar


def crossing_targets(situation: str = "IV", clutter_per_scan: float = 56.0) -> Scene:
    """Return the paper's three crossing targets: 7 looks, 2 s apart, over 3.5 km × 1.6 km.

    Situation I is ideal, II has noise of 10 m, III clutter, IV both; P_D = 0.99 in all.

    Args:
        situation: I, II, III or IV.
        clutter_per_scan: expected clutter of situations III and IV; 56 a look is the paper's
            10 a square kilometre, its run times fit 10 a look.

    Raises:
        ValueError: an unknown situation.

    Example:
        >>> print(crossing_targets("II").truth.state.shape)
        (7, 3, 4)

    Source: neutrosophic Hough transform (2018), table 1 and section V-A.

    Note:
        Table 1 prints ẏ = −100 for target 2, which would run parallel to target 3 and out of the
        picture; +100 gives the crossings and the extent of the paper's figure 4.
    """
    check_choice("situation", situation, SITUATIONS)
    initial = np.array(
        [
            [300.0, 400.0, 280.0, 49.0],
            [3000.0, 300.0, -173.2, 100.0],
            [2100.0, 1300.0, -173.2, -100.0],
        ]
    )
    time_s = 2.0 * np.arange(7)
    truth = _straight(initial, time_s)
    noisy, cluttered = situation in ("II", "IV"), situation in ("III", "IV")
    radar = Radar(
        sigma_m=10.0 if noisy else 0.0,
        clutter_per_scan=clutter_per_scan if cluttered else 0.0,
    )
    return Scene(truth, radar)


def radar_measurements(sigma_m: float = 0.0, clutter_per_scan: float = 10.0) -> Scene:
    """Return the paper's real radar measurements of three targets: 7 looks, 10 s apart.

    The "truth" are the 21 measured dots themselves (table 3, as package data), their velocities
    the differences of neighbours; the radar adds what is asked for.

    Args:
        sigma_m: noise added to the measured dots.
        clutter_per_scan: clutter added, over the field of 25 km × 18 km.

    Example:
        >>> print(radar_measurements().truth.state[0, 0, :2])
        [-23793.  24841.]

    Source: neutrosophic Hough transform (2018), table 3 and section V-B.
    """
    text = resources.files("jaxtrack.sensors").joinpath("data/radar_table3.csv").read_text()
    rows = list(csv.DictReader(text.splitlines()))
    column = lambda name: np.array([float(row[name]) for row in rows]).reshape(7, 3)
    position = np.stack([column("x_m"), column("y_m")], axis=-1)
    time_s = column("time_s")[:, 0]
    velocity = np.gradient(position, time_s, axis=0)
    dtype = jnp.result_type(float)
    state = jnp.asarray(np.concatenate([position, velocity], axis=-1), dtype)
    truth = Truth(jnp.asarray(time_s, dtype), state, jnp.ones((7, 3), bool))
    radar = Radar(
        sigma_m=sigma_m,
        clutter_per_scan=clutter_per_scan,
        field_low_m=(-25000.0, 12000.0),
        field_high_m=(0.0, 30000.0),
    )
    return Scene(truth, radar)


class SceneLimits(NamedTuple):
    """What random scenes keep to. Written down before any method saw one. Traced."""

    v_min_m_s: Array | float = 120.0
    v_max_m_s: Array | float = 380.0
    margin_m: Array | float = 50.0  # every target stays this far inside the field, all looks
    line_rho_m: Array | float = 150.0  # two targets' lines differ by this …
    line_theta_rad: Array | float = 0.15  # … or by this


def random_targets(
    key: Key, radar: Radar, limits: SceneLimits, *, targets: int, looks: int = 7, dt_s: float = 2.0
) -> tuple[Truth, Array]:
    """Return straight random trajectories, and whether they keep to every limit.

    Mid-window positions are uniform over the field and headings over the circle; speeds are uniform
    between v_min and the smaller of v_max and what keeps the path inside the field. The first of
    64 draws that fits is taken for each target. A scene that breaks a limit is returned all the
    same, with the flag down, so that studies can report such scenes apart.

    Args:
        key: random key.
        radar: whose field it is.
        limits: speeds, margin and separation of lines.
        targets: how many, static.
        looks: how many, static.
        dt_s: time between looks.

    Example:
        >>> truth, within = random_targets(jax.random.key(0), Radar(), SceneLimits(), targets=2)
        >>> print(truth.state.shape)
        (7, 2, 4)
    """
    check_size("targets", targets)
    check_size("looks", looks, at_least=2)
    dtype = jnp.result_type(float)
    low, high = jnp.asarray(radar.field_low_m, dtype), jnp.asarray(radar.field_high_m, dtype)
    margin = jnp.asarray(limits.margin_m, dtype)
    half_s = dt_s * (looks - 1) / 2
    draws, moves = jax.random.split(key)

    def target(key: Key) -> tuple[Array, Array]:
        keys = jax.random.split(key, 3)
        middle = jax.random.uniform(keys[0], (64, 2), dtype, low, high)
        heading = 2 * jnp.pi * jax.random.uniform(keys[1], (64,), dtype)
        unit = jnp.stack([jnp.cos(heading), jnp.sin(heading)], axis=-1)
        room = jnp.minimum(middle - low[None], high[None] - middle) - margin
        fits = (room / (half_s * jnp.maximum(jnp.abs(unit), 1e-6))).sort(axis=-1)[:, 0]
        fastest = jnp.minimum(fits, jnp.asarray(limits.v_max_m_s, dtype))
        slowest = jnp.asarray(limits.v_min_m_s, dtype)
        first = jnp.argmax(fastest >= slowest)
        share = jax.random.uniform(keys[2], (), dtype)
        speed = slowest + share * (fastest[first] - slowest)
        velocity = speed * unit[first]
        return jnp.concatenate([middle[first] - half_s * velocity, velocity]), (
            fastest[first] >= slowest
        )

    initial, fits = jax.vmap(target)(jax.random.split(draws, targets))
    time_s = jnp.asarray(dt_s, dtype) * jnp.arange(looks, dtype=dtype)
    truth = move(moves, initial, time_s)
    rho, theta = line_through(initial[:, :2], initial[:, :2] + initial[:, 2:], jnp.zeros(2, dtype))
    d_rho, d_theta = line_difference(rho[:, None], theta[:, None], rho[None, :], theta[None, :])
    apart = (jnp.abs(d_rho) > limits.line_rho_m) | (jnp.abs(d_theta) > limits.line_theta_rad)
    return truth, fits.all() & (apart | jnp.eye(targets, dtype=bool)).all()


def _straight(initial: np.ndarray, time_s: np.ndarray) -> Truth:
    position = initial[None, :, :2] + time_s[:, None, None] * initial[None, :, 2:]
    velocity = np.broadcast_to(initial[None, :, 2:], position.shape)
    dtype = jnp.result_type(float)
    state = jnp.asarray(np.concatenate([position, velocity], axis=-1), dtype)
    return Truth(jnp.asarray(time_s, dtype), state, jnp.ones(state.shape[:2], bool))
