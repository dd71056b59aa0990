"""What the study `tune_tracker` simulates: the loss that is tuned by, and the score that counts.

The loss is that of the tracker with soft lives, its tracks weighed by their existence. The score is
the tracker as people use it, with its gate, its M-of-N rule and its deletions.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxtrack.metrics import ospa
from jaxtrack.sensors import Radar, observe
from jaxtrack.sensors.radar import move
from jaxtrack.studies.tuned.ways import Score, Settings, smooth_ospa
from jaxtrack.tracking import (
    KalmanTrackerParams,
    LifecycleParams,
    kalman_tracker,
    soft_lives,
)
from jaxtrack.tracking.lives import Lives
from jaxtrack.tracking.soft_lifecycle import Softness
from jaxtrack.types import Array, Key, Scan, Stage, Tracks, Truth

CUTOFF_M, ORDER = 20.0, 2.0
RADAR = Radar(0.9, 3.0, 1.0, (0.0, 0.0), (600.0, 600.0))
ACCELERATION_M_S2 = 0.5  # of each coordinate; a look is a second
SOFT = Softness(share=0.05, looks=0.125, score=0.5, gate=0.5)  # half the defaults
_TARGETS, _LOOKS, _DETECTIONS, _SLOTS = 3, 40, 10, 8


def hand() -> dict[str, float]:
    """Return what is set by hand: noise as the scene has it, the library's gate and birth.

    Six nats of evidence confirm: a false track a thousand candidates or two.
    """
    return {
        "gate": 9.21,
        "sigma_m": 3.0,
        "sigma_a_m_s2": ACCELERATION_M_S2,
        "birth_sigma_m_s": 10.0,
        "confirm_score": 6.0,
    }


def loss(settings: Settings, key: Key) -> Array:
    """Return the smooth OSPA of one scene, mean over its looks, in units of the cut-off."""
    truth, scans = _simulate(key)
    tracks, _ = _track(settings, scans, soft_lives(SOFT))
    look = functools.partial(smooth_ospa, cutoff=CUTOFF_M, order=ORDER)
    each = jax.vmap(look)(tracks, tracks.existence, truth.state, truth.mask)
    return each.mean() / CUTOFF_M


def score(settings: Settings, key: Key) -> Score:
    """Return the mean OSPA over the looks of one scene, in metres."""
    truth, scans = _simulate(key)
    tracks, full = _track(settings, scans, None)
    confirmed = tracks.mask & (tracks.stage >= Stage.CONFIRMED)
    each = jax.vmap(lambda *sets: ospa(*sets, cutoff=CUTOFF_M, order=ORDER).distance)
    found = each(tracks.mean[..., :2], confirmed, truth.state[..., :2], truth.mask)
    return Score(found.mean(keepdims=True), full.any())


def _track(
    settings: Settings, scans: Scan, lives: Callable[..., Lives] | None
) -> tuple[Tracks, Array]:
    dtype = scans.position_m.dtype
    field = jnp.asarray(RADAR.field_high_m, dtype) - jnp.asarray(RADAR.field_low_m, dtype)
    params = KalmanTrackerParams(
        settings["sigma_m"],
        settings["sigma_a_m_s2"],
        RADAR.p_detect,
        RADAR.clutter_per_scan / field.prod(),
        settings["birth_sigma_m_s"],
        gate=settings["gate"],
        lifecycle=LifecycleParams(2, settings["confirm_score"], 5, 2),
    )
    tracker = kalman_tracker(params, max_tracks=_SLOTS, lives=lives)
    # Computed again on the way back: what a look leaves behind is more than the state.
    step = jax.checkpoint(tracker.step, prevent_cse=False)
    _, info = jax.lax.scan(step, tracker.init(jax.random.key(0)), scans)
    return info.tracks, info.full


def _simulate(key: Key) -> tuple[Truth, Scan]:
    """Return targets that come and go, and what the radar sees of them."""
    draw, turn, look = jax.random.split(key, 3)
    dtype = jnp.result_type(float)
    # One draw for all of it: each is a second of compilation.
    x, y, speed, course, born, gone = jax.random.uniform(draw, (6, _TARGETS), dtype)
    time_s = jnp.arange(_LOOKS).astype(dtype)
    low, high = (jnp.asarray(corner, dtype) for corner in (RADAR.field_low_m, RADAR.field_high_m))
    middle = low[None] + (high - low)[None] * (0.3 + 0.4 * jnp.stack([x, y], axis=-1))
    velocity = (4 + 8 * speed)[:, None] * jnp.stack(
        [jnp.cos(2 * jnp.pi * course), jnp.sin(2 * jnp.pi * course)], axis=-1
    )
    start = jnp.concatenate([middle - velocity * time_s[-1] / 2, velocity], axis=-1)
    truth = move(turn, start, time_s, ACCELERATION_M_S2)
    share = time_s[:, None] / _LOOKS
    truth = truth._replace(mask=(share >= born[None] / 2) & (share < 0.6 + gone[None]))
    return truth, observe(look, truth, RADAR, detections=_DETECTIONS)
