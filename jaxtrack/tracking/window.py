"""From the looks of a recording to tracks: sizes, grid, clutter and gate are read off the data.

The looks are one window. What is asked of the user is what the data cannot tell: speeds, noise,
detection probability and the rate of false tracks. The gate then comes from scenes without targets
that look like the recording (same times, same field, same clutter), run by the same method.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.hough import gate_for_false_rate, improved, joint, modified, neutrosophic, standard
from jaxtrack.hough.grid import Grid
from jaxtrack.hough.joint import JointSizes
from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.hough.peaks import Peaks
from jaxtrack.models.motion import look_times
from jaxtrack.models.observation import PositionSensor
from jaxtrack.montecarlo import monte_carlo
from jaxtrack.numerics.checks import check_choice, check_scans, check_size
from jaxtrack.sensors.radar import Radar, observe
from jaxtrack.tracking.initiate import InitiateParams, initiate
from jaxtrack.tracking.prepared import MOST_TRACKS, on_device
from jaxtrack.tracking.window_sizes import Field, choose_sizes, field_of
from jaxtrack.types import Array, Key, Scan, Stage, Tracks, Truth

METHODS = ("joint", "neutrosophic", "improved", "modified", "standard")
FALSE_PER_RUN = (0.001, 1.0)
"""The false-track rates that can be asked for: rarer ones would need more than 10 000 scenes."""


class WindowInfo(NamedTuple):
    """What people look at."""

    gate: float  # what a track's score had to reach; infinite where nothing can start a track
    looks: Array  # [M] looks in which a track has a detection
    smoothed_m: Array  # [M, K, 2] where a track was at every look
    clutter_per_m2: float  # detections a square metre and look
    trials: int  # scenes without targets that the gate comes from
    notes: tuple[str, ...]  # what did not fit, in sentences


class Model(NamedTuple):
    """What the methods are told about sensor, targets and field. Traced."""

    sensor: PositionSensor
    speed: SpeedGate
    grid: Grid


class Scenes(NamedTuple):
    """How scenes without targets are drawn. Traced."""

    like: Scan  # the recording: its times, and its detections' covariances, weights, delays
    radar: Radar


def initiate_window(
    scans: Scan,
    *,
    method: str = "joint",
    speed: SpeedGate = SpeedGate(),  # noqa: B008 - an immutable tuple
    sigma_m: float = 10.0,
    p_detect: float = 0.9,
    false_per_run: float = 0.01,
    max_tracks: int = 8,
    key: Key | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> tuple[Tracks, WindowInfo]:
    """Return the tracks that start in a recording's looks, taken as one window.

    Not for `jit`: array sizes, grid and gate depend on the values of the data.

    Args:
        scans: K looks stacked, as a `Recording` holds them.
        method: one of `METHODS`.
        speed: slowest and fastest target, m/s.
        sigma_m: noise of a detection, metres; the joint vote prefers the scans' own covariances.
        p_detect: probability that a target is detected in a look, in (0, 1).
        false_per_run: wanted mean number of false tracks in such a window, 0.001 to 1.
        max_tracks: tracks that are looked for.
        key: for the scenes without targets; None: `jax.random.key(0)`.
        on_progress: called as `on_progress(scenes done, scenes)`.

    Returns:
        Tracks in order of their scores, and what people look at, the gate among it. One look, or
        looks without detections, start no track.

    Raises:
        ValueError: an option is out of range, a position is not finite, or times run back.

    Example:
        >>> scans = Scan(2.0 * np.arange(5), np.ones(5, bool),
        ...              np.stack([400.0 * np.arange(5), np.full(5, 80.0)], -1)[:, None],
        ...              np.ones((5, 1), bool))
        >>> tracks, info = initiate_window(scans, false_per_run=0.1, max_tracks=1)
        >>> print(int(tracks.mask.sum()), int(info.looks[0]), info.gate < 20)
        1 5 True

    Note:
        Targets' own detections count as clutter, and clutter as even over the bounding box of all
        detections: few targets in much clutter make both harmless. Tolerances of the Hough methods
        are the paper's at a noise of 10 m and grow with it, but for what decides whether noisy
        pairs meet at all: here the neutrosophic memberships use every pair's own covariance, and
        the modified and improved vote falls in cells of 50 m × 30 mrad (the standard one: 5 m ×
        1 mrad), wider along ρ where there would be over 2048 of them.
    """
    _check_options(method, speed, sigma_m, p_detect, false_per_run, max_tracks)
    key = jax.random.key(0) if key is None else key
    scans = on_device(check_scans(scans))
    if scans.weight is not None:
        scans = scans._replace(mask=scans.mask & (scans.weight > 0))
    field = field_of(scans, sigma_m)
    looks = int(np.sum(scans.valid))
    if looks < 2 or field.detections_per_look == 0.0:
        why = "one look starts no track" if looks < 2 else "there are no detections"
        return _nothing(scans, max_tracks, field, why)

    sizes, notes = choose_sizes(scans, field, speed, sigma_m, method=method, tracks=max_tracks)
    number = lambda x: jnp.asarray(x, scans.position_m.dtype)
    sensor = PositionSensor(*map(number, (p_detect, field.clutter_per_m2, sigma_m)))
    speed = SpeedGate(*map(number, speed))
    grid = Grid(number(field.centre_m), number(field.rho_max_m))
    model = Model(sensor, speed, grid)
    radar = Radar(*map(number, (0.0, sigma_m, field.detections_per_look, *field.corners_m)))

    trials = math.ceil(10.0 / false_per_run)
    # Clutter seldom makes two tracks that pass: to look for three of them saves most of the time.
    fewer = sizes._replace(tracks=min(max_tracks, 3)) if isinstance(sizes, JointSizes) else sizes
    trial = _trial(method, fewer, field.most_detections)
    run = monte_carlo(
        trial,
        key,
        trials,
        (Scenes(scans, radar), model),
        micro_batch=1,  # the tables of one scene already fill the cache
        on_progress=on_progress,
    )
    score, found, overflow = run.values
    gate = gate_for_false_rate(jnp.asarray(score), jnp.asarray(found), false_per_run)

    tracks, seen, smoothed, full = _compiled(method, sizes)(scans, model, gate)
    if bool(full):
        notes += ("the recording holds more candidate pairs than fit: tracks may be missing",)
    if overflow.mean() > 0.01:
        notes += ("scenes without targets hold more candidate pairs than fit: the gate may be low",)
    return tracks, WindowInfo(float(gate), seen, smoothed, field.clutter_per_m2, trials, notes)


def _check_options(
    method: str,
    speed: SpeedGate,
    sigma_m: float,
    p_detect: float,
    false_per_run: float,
    max_tracks: int,
) -> None:
    def check(name: str, value: Any, fits: bool, want: str) -> None:
        if not (fits and math.isfinite(value)):
            raise ValueError(f"{name}: got {value:g}, want {want}")

    check_choice("method", method, METHODS)
    slowest, fastest = float(speed.v_min_m_s), float(speed.v_max_m_s)
    check("speed_min_m_s", slowest, slowest >= 0, "a speed of at least 0 m/s")
    check("speed_max_m_s", fastest, fastest > slowest, f"more than speed_min_m_s, {slowest:g}")
    check("sigma_m", sigma_m, sigma_m > 0, "a positive number of metres")
    check("p_detect", p_detect, 0 < p_detect < 1, "a probability between 0 and 1")
    low, high = FALSE_PER_RUN
    rates = f"a rate from {low:g} to {high:g}"
    check("false_per_run", false_per_run, low <= false_per_run <= high, rates)
    if check_size("max_tracks", max_tracks) > MOST_TRACKS:
        raise ValueError(f"max_tracks: got {max_tracks}, want at most {MOST_TRACKS}")


def _estimate(
    scans: Scan, model: Model, gate: Array, *, method: str, sizes: Any
) -> tuple[Tracks, Array, Array, Array]:
    """Return tracks, their numbers of looks [M], positions [M, K, 2] and the overflow flag."""
    sensor, speed, grid = model
    if method == "joint":
        params = joint.JointParams(sensor, speed, gate)
        tracks, info = joint.estimate(scans, params, sizes=sizes)
        dt, _ = look_times(scans)
        path = tracks.mean[:, None, :2] + tracks.mean[:, None, 2:4] * dt[None, :, None]
        seen = (info.responsibility.sum(-1) > 0.5).sum(-1)
        return tracks, seen, path, info.overflow
    sigma_m = sensor.sigma_m
    peaks = Peaks(separation_rho_m=10.2 * sigma_m, gate=gate, member_m=3 * sigma_m)
    if method == "standard":
        lines, info = standard.estimate(scans, standard.StandardParams(grid, peaks), sizes=sizes)
    elif method == "modified":
        lines, info = modified.estimate(scans, modified.ModifiedParams(grid, peaks), sizes=sizes)
    elif method == "improved":
        params = improved.ImprovedParams(grid, peaks, speed)
        lines, info = improved.estimate(scans, params, sizes=sizes)
    else:
        params = neutrosophic.NeutrosophicParams(
            grid, peaks, speed, eps_rho_m=2 * sigma_m, sigma_m=sigma_m
        )
        rules = neutrosophic.Rules(scale="covariance")
        lines, info = neutrosophic.estimate(scans, params, sizes=sizes, rules=rules)
    near = InitiateParams(6 * sigma_m, 9 * sigma_m, sigma_m, speed)
    tracks, started = initiate(scans, lines, near)
    return tracks, (started.member >= 0).sum(-1), started.smoothed_m, info.overflow


@functools.lru_cache(maxsize=16)
def _compiled(method: str, sizes: Any) -> Callable[..., Any]:
    return jax.jit(functools.partial(_estimate, method=method, sizes=sizes))


@functools.lru_cache(maxsize=16)
def _trial(method: str, sizes: Any, detections: int) -> Callable[..., Any]:
    """Return one scene without targets as `monte_carlo` takes it; equal sizes share a program."""

    def trial(key: Key, params: tuple[Scenes, Model]) -> tuple[Array, Array, Array]:
        (like, radar), model = params
        scans = _target_free(key, like, radar, detections)
        gate = jnp.zeros((), like.position_m.dtype)
        tracks, _, _, overflow = _estimate(scans, model, gate, method=method, sizes=sizes)
        return tracks.log_score, tracks.mask, overflow

    return trial


def _target_free(key: Key, like: Scan, radar: Radar, detections: int) -> Scan:
    """Return clutter at a recording's times; what else a detection has is drawn from the others."""
    draw, pick = jax.random.split(key)
    looks, dtype = like.time_s.shape[0], like.position_m.dtype
    nobody = Truth(like.time_s, jnp.zeros((looks, 0, 4), dtype), jnp.zeros((looks, 0), bool))
    scans = observe(draw, nobody, radar, detections=detections)
    counts = (like.mask & like.valid[:, None]).ravel().astype(dtype)
    chance = counts / counts.sum()
    index = jax.random.choice(pick, counts.shape[0], (looks, detections), p=chance)
    again = lambda x: None if x is None else x.reshape(-1, *x.shape[2:])[index]
    return scans._replace(
        valid=like.valid,
        covariance_m2=again(like.covariance_m2),
        weight=again(like.weight),
        delay_s=again(like.delay_s),
    )


def _nothing(scans: Scan, tracks: int, field: Field, why: str) -> tuple[Tracks, WindowInfo]:
    number = lambda *shape: jnp.zeros(shape, scans.position_m.dtype)
    empty = Tracks(
        time_s=look_times(scans)[1],
        mean=number(tracks, 4),
        covariance=number(tracks, 4, 4),
        mask=jnp.zeros(tracks, bool),
        identity=jnp.full(tracks, -1),
        stage=jnp.full(tracks, Stage.EMPTY),
        existence=number(tracks),
        log_score=number(tracks),
    )
    path = number(tracks, scans.time_s.shape[0], 2)
    looks = jnp.zeros(tracks, int)
    return empty, WindowInfo(math.inf, looks, path, field.clutter_per_m2, 0, (why,))
