"""Two targets that meet and fade, followed by the Kalman tracker with JPDA: what is falsified.

Run as a module from the root, this file makes `tests/golden/fading_crossings.json` again, in some
five minutes: `python -m tests.tuning.fading_crossings`.
"""

import functools
import math
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxtrack.metrics import swap_and_loss
from jaxtrack.sensors import (
    EchoSensor,
    Fade,
    Meeting,
    drop,
    fade,
    meeting_targets,
    observe_echoes,
)
from jaxtrack.tracking import KalmanTrackerParams, kalman_tracker, soft_lives
from jaxtrack.tuning import falsify, write_regression_scenes
from jaxtrack.types import Scan

FILE = pathlib.Path(__file__).resolve().parent.parent / "golden" / "fading_crossings.json"
SENSOR = EchoSensor(p_detect=0.9, echoes=1.0, spread_m=0.5, clutter_per_m2=0.002)
PARAMS = KalmanTrackerParams(0.5, 0.15, 0.9, 0.002, birth_sigma_m_s=1.5)
LEAD, LAST = 3, 6  # looks of both targets alone at the start; looks at the end that count
AWAY_M = 3.0

LOW = {
    "angle_rad": math.radians(20.0),
    "gap_m": -4.0,
    "fade_middle_s": np.full(2, 6.0),
    "fade_length_s": np.zeros(2),
}
HIGH = {
    "angle_rad": math.radians(90.0),
    "gap_m": 4.0,
    "fade_middle_s": np.full(2, 18.0),
    "fade_length_s": np.full(2, 4.0),
}
SCORE = {"broken": 0.0, "swap": 0.0, "lost": 0.0}


def wandering(key, meeting):
    """Return targets whose accelerations bend their ways from the first look on.

    Where they meet is not known to the ascent any better than to the tracker.
    """
    straight = meeting_targets(key, meeting._replace(sigma_a_m_s2=0.0))
    push = meeting.sigma_a_m_s2 * jax.random.normal(key, (straight.time_s.shape[0] - 1, 2, 2))
    gained = jnp.cumsum(push, axis=0)  # of velocity, after each look
    moved = jnp.cumsum(gained - push / 2, axis=0)
    bend = jnp.pad(jnp.concatenate([moved, gained], axis=-1), ((1, 0), (0, 0), (0, 0)))
    return straight._replace(state=straight.state + bend)


def simulate(scene, key):
    """Return truth and looks, in which fading targets weigh less, and a key for what is drawn."""
    path, look, rest = jax.random.split(key, 3)
    meeting = Meeting(scene["angle_rad"], scene["gap_m"])
    truth = wandering(path, meeting)
    seen = observe_echoes(look, truth, SENSOR, echoes=1, clutter=12)
    fades = Fade(scene["fade_middle_s"], scene["fade_length_s"], edge_s=0.5)
    return truth, fade(seen.scans, seen.origin, fades), rest


def follow(truth, scans, lives=None):
    """Return the tracks [T, 2] that started on either target, and where they still are those.

    Before the first look there are three that show the targets and nothing else, so that slots 0
    and 1 hold their tracks.
    """
    places = scans.mask.shape[1]
    time_s = jnp.arange(-LEAD, 0.0)
    start = truth.state[0]
    at = start[None, :, :2] + time_s[:, None, None] * start[None, :, 2:]
    at = jnp.pad(at, ((0, 0), (0, places - 2), (0, 0)))
    there = jnp.broadcast_to(jnp.arange(places) < 2, (LEAD, places))
    weight = None if scans.weight is None else jnp.ones((LEAD, places))
    lead = Scan(time_s, jnp.ones(LEAD, bool), at, there, weight=weight)
    whole = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), lead, scans)
    tracker = kalman_tracker(PARAMS, max_tracks=8, lives=lives)
    _, info = jax.lax.scan(jax.checkpoint(tracker.step), tracker.init(jax.random.key(0)), whole)
    tracks = jax.tree.map(
        lambda x: x[LEAD:, :2], info.tracks._replace(time_s=whole.time_s[:, None])
    )
    return tracks, tracks.mask & (tracks.identity == jnp.arange(2, dtype=jnp.int32)[None, :])


def loss(scene, key):
    """Return how far off the tracks end, in [0, 1]; what is lost of them is at 1.

    Their lives are soft: misses wear a track down before it is lost, and that has a slope.
    """
    truth, scans, _ = simulate(scene, key)
    tracks, there = follow(truth, scans, soft_lives())
    squared = ((tracks.mean[..., :2] - truth.state[..., :2]) ** 2).sum(-1)
    kept = jnp.where(there, tracks.existence, 0.0)
    return (1.0 - kept * AWAY_M**2 / (squared + AWAY_M**2))[-LAST:].mean()


def verdict(scene, key):
    """Return whether tracks were exchanged or lost, where fading targets are really not seen."""
    truth, scans, rest = simulate(scene, key)
    tracks, there = follow(truth, drop(rest, scans))
    seen = swap_and_loss(tracks.mean[..., :2], truth.state[..., :2], there, limit_m=AWAY_M)
    share = lambda x: x.astype(tracks.mean.dtype)
    return {
        "broken": share(seen.swap | seen.loss),
        "swap": share(seen.swap),
        "lost": share(seen.loss),
    }


find = functools.partial(
    falsify, loss, verdict, LOW, HIGH, optax.adam(0.2), batch=32, holdout=128, clip=0.1
)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    worst = find(key=jax.random.key(0), starts=6, steps=40, verify=2000)
    write_regression_scenes(
        FILE,
        worst,
        about="two meeting targets that fade, Kalman tracker with JPDA; made by "
        "python -m tests.tuning.fading_crossings; broken: exchanged or lost, share of runs",
    )
