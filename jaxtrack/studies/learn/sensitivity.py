"""Which specification of a sonar matters: the derivative of a tracker's OSPA in each of them.

OSPA of the joint vote jumps wherever a track appears or leaves, and detections come and go as a
whole. A gradient through the program would miss the jumps. So the derivative is that of the mean,
by the score function: with f the OSPA of one window, z what was drawn for it,

    d E f / dθ = E[(f − E f) ∂ log p(z; θ)/∂θ],

without bias whatever f does. Beside it stand central differences on common random numbers.

Assumed: a sonar of positions in polar coordinates, its beams' width Δ standing for Gaussian noise
of the bearing with the same variance, Δ²/12; K places a look that each give a false alarm with
P_F, uniform in range and bearing. The tracker keeps what it was told, the nominal sonar: where
what it is told is right, telling it anew would change little.
"""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from jaxtrack.hough import SpeedGate, joint
from jaxtrack.metrics import ospa
from jaxtrack.models import POSITION, BeamSonar, PositionSensor
from jaxtrack.models.frames import earth_to_polar, polar_to_earth
from jaxtrack.numerics.safe import safe_log
from jaxtrack.sensors import SonarSceneLimits, in_sight, random_sonar_scene
from jaxtrack.studies import parts
from jaxtrack.studies.registry import Context
from jaxtrack.types import Array, Key, Pose, Scan, Truth

LOOKS = 12
TARGETS = 2
PLACES = 16  # K, a look
CUTOFF_M, ORDER = 20.0, 2.0
GATE = 8.0
STEP = 0.2  # of a specification, to each side, for the differences
DIFFERENCES = 4  # of so many scenes one is differenced as well
_SONAR = BeamSonar()  # its scope and sector
_SIZES = joint.JointSizes(4, 2048, candidates=128, starts=8, gap=6, samples=64)


class Specification(NamedTuple):
    """What a sonar is sold by. Traced."""

    sigma_m: Array | float = 3.0  # noise of a range
    beam_rad: Array | float = math.radians(3.0)  # Δ
    p_miss: Array | float = 0.3
    p_false: Array | float = 0.5  # of each place


NAMES = ("range noise σ", "beam width", "P_M", "P_F")
UNITS = ("m", "rad", "", "")


class Draws(NamedTuple):
    """All randomness of a window, alike for every specification."""

    truth: Truth
    pose: Pose
    noise: Array  # [T, K, 2] standard normal, of range and bearing
    heard: Array  # [T, K] uniform
    alarm: Array  # [T, P] uniform
    place: Array  # [T, P, 2] uniform


class Report(NamedTuple):
    """What the sonar made of the draws: all that the tracker sees depends on these."""

    range_m: Array  # [T, K] of the targets
    bearing_rad: Array  # [T, K]
    hit: Array  # [T, K]
    alarm: Array  # [T, P]


def draw(key: Key) -> Draws:
    """Draw a window."""
    keys = jax.random.split(key, 5)
    (truth, pose, _), _ = random_sonar_scene(
        keys[0], _SONAR, SonarSceneLimits(), targets=TARGETS, looks=LOOKS
    )
    truth = in_sight(truth, pose, _SONAR)
    dtype = truth.state.dtype
    noise = jax.random.normal(keys[1], (LOOKS, TARGETS, 2), dtype)
    heard = jax.random.uniform(keys[2], (LOOKS, TARGETS), dtype)
    alarm = jax.random.uniform(keys[3], (LOOKS, PLACES), dtype)
    place = jax.random.uniform(keys[4], (LOOKS, PLACES, 2), dtype)
    return Draws(truth, pose, noise, heard, alarm, place)


def report(draws: Draws, spec: Specification) -> Report:
    """Return what a sonar of this specification makes of the draws."""
    range_m, bearing_rad = _true(draws)
    noise = draws.noise
    return Report(
        range_m + spec.sigma_m * noise[..., 0],
        bearing_rad + spec.beam_rad / math.sqrt(12) * noise[..., 1],
        draws.truth.mask & (draws.heard >= spec.p_miss),
        draws.alarm < spec.p_false,
    )


def log_density(draws: Draws, seen: Report, spec: Specification) -> Array:
    """Return log p of a report given the scene, up to what no specification changes."""
    range_m, bearing_rad = _true(draws)
    p_miss, p_false = spec.p_miss, spec.p_false
    spread_rad = spec.beam_rad / math.sqrt(12)
    normal = lambda x, sigma: -((x / sigma) ** 2) / 2 - safe_log(sigma)
    echo = normal(seen.range_m - range_m, spec.sigma_m) + safe_log(1 - p_miss)
    echo = echo + normal(seen.bearing_rad - bearing_rad, spread_rad)
    target = jnp.where(draws.truth.mask, jnp.where(seen.hit, echo, safe_log(p_miss)), 0.0)
    clutter = jnp.where(seen.alarm, safe_log(p_false), safe_log(1 - p_false))
    return target.sum() + clutter.sum()


def tracked(draws: Draws, seen: Report) -> Array:
    """Return the OSPA of the joint vote, told of the nominal sonar."""
    told = Specification()
    scope_m, sector = _SONAR.range_max_m, _SONAR.sector_rad
    false_m = scope_m * draws.place[..., 0]
    range_m = jnp.concatenate([seen.range_m, false_m], axis=1)
    bearing_rad = jnp.concatenate([seen.bearing_rad, sector * (draws.place[..., 1] - 0.5)], axis=1)
    mask = jnp.concatenate([seen.hit, seen.alarm], axis=1)
    position_m = jax.vmap(lambda r, b, pose: polar_to_earth(r, b, pose, _SONAR.mount_m))(
        range_m, bearing_rad, draws.pose
    )
    angle = bearing_rad + draws.pose.heading_rad[:, None]
    along = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
    across = jnp.stack([-along[..., 1], along[..., 0]], axis=-1)
    outer = lambda u: u[..., :, None] * u[..., None, :]
    wide = (range_m * told.beam_rad) ** 2 / 12
    covariance = told.sigma_m**2 * outer(along) + wide[..., None, None] * outer(across)
    scans = Scan(draws.truth.time_s, jnp.ones(LOOKS, bool), position_m, mask, covariance)
    density = PLACES * told.p_false / (sector * scope_m**2 / 2)
    sensor = PositionSensor(1 - told.p_miss, density, told.sigma_m)
    params = joint.JointParams(sensor, SpeedGate(0.0, 6.0), GATE)
    tracks, _ = joint.estimate(scans, params, sizes=_SIZES, observation=POSITION)
    truth, there = draws.truth.state[-1, :, :2], draws.truth.mask.any(0)
    sets = tracks.mean[:, :2], tracks.mask, truth, there
    return ospa(*sets, cutoff=CUTOFF_M, order=ORDER).distance


def scored(key: Key, spec: Specification) -> tuple[Array, Specification]:
    """Return the OSPA of one window and ∂ log p/∂θ."""
    draws = draw(key)
    seen = report(draws, spec)
    slope = jax.grad(lambda spec: log_density(draws, jax.lax.stop_gradient(seen), spec))(spec)
    return tracked(draws, seen), slope


def measure(context: Context, key: Key, scenes: int) -> xr.Dataset:
    """Return d OSPA / d specification by both ways, with standard errors.

    Args:
        context: of the study.
        key: of the windows; both ways see the same ones.
        scenes: of the score function.
    """
    told = np.array(Specification(), np.float64)

    def run(what: str, values: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return OSPA [N] and scores [N, S]; the same program and draws whatever the values."""
        spec = Specification(*map(jnp.asarray, values.astype(jnp.result_type(float))))
        report = functools.partial(context.progress, f"sensitivity, {what}")
        f, slopes = parts.run_part(context, what, scored, key, count, spec, report)
        return np.asarray(f, np.float64), np.stack(slopes, axis=-1).astype(np.float64)

    f, score = run("score function", told, scenes)
    # The score's mean is known to be zero: taking the sample's out takes noise away.
    each = (f - f.mean())[:, None] * (score - score.mean(0)) * len(f) / max(len(f) - 1, 1)
    few = max(scenes // DIFFERENCES, 2)
    difference = np.empty((few, len(told)))
    for place, name in enumerate(NAMES):
        step = STEP * told * (np.arange(len(told)) == place)
        ends = [run(f"{name} {sign:+d}", told + sign * step, few)[0] for sign in (1, -1)]
        difference[:, place] = (ends[0] - ends[1]) / (2 * step[place])
    error = lambda x: x.std(0, ddof=1) / np.sqrt(len(x))
    return xr.Dataset(
        {
            "specification": ("name", told),
            "slope": ("name", each.mean(0)),
            "slope_error": ("name", error(each)),
            "difference": ("name", difference.mean(0)),
            "difference_error": ("name", error(difference)),
            "ospa": ((), f.mean(), {"units": "m"}),
        },
        coords={"name": list(NAMES), "unit": ("name", list(UNITS))},
        attrs={"scenes": scenes, "scenes_of_differences": few},
    )


def _true(draws: Draws) -> tuple[Array, Array]:
    """Return the targets' true ranges and bearings, [T, K] each."""
    mount_m = jnp.asarray(_SONAR.mount_m, draws.noise.dtype)
    polar = jax.vmap(earth_to_polar, (0, 0, None))
    return polar(draws.truth.state[..., :2], draws.pose, mount_m)
