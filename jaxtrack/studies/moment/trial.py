"""One trial of the study `moment_tracking`: a bucket, its sweeps, and every tracker on them.

Scene, speed and distances are traced: every cell of every table is the same compiled program. Files
of studies name the parts: the scene `bucket`, the methods `moments` and `shape`, and the metrics.
"""

import functools
import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.safe import safe_divide, safe_norm
from jaxtrack.sensors import (
    IMAGENEX_881L,
    MOTIONS,
    SURROUNDINGS,
    DraggedBucket,
    cloud_of_pings,
    dragged_bucket,
)
from jaxtrack.tracking import (
    detect_in_pings,
    moment_template,
    moment_tracker,
    shape_template,
    shape_tracker,
)
from jaxtrack.types import Array, Key, Scan, Truth

FRAMES, FIRST = 30, 3  # of a run; of the template
SCENES = tuple(itertools.product(MOTIONS, SURROUNDINGS))
FEATURES = {  # name: features and origin
    "hu": ("hu", "particle"),
    "zernike": ("zernike", "particle"),
    "zernike, centroid": ("zernike", "centroid"),
    "low_zernike": ("low_zernike", "particle"),
    "low_zernike, centroid": ("low_zernike", "centroid"),
}
OPTIMISED = ", optimised"
OURS = "shape"
METHODS = (*(name + word for name in FEATURES for word in ("", OPTIMISED)), OURS)
LAST, FAR_M = 5, 3.0  # a run is lost whose last looks are so far off
SIDE_M = 0.29  # from a bucket's middle to the centroid of the side that echoes: ¾ of its radius


class Inputs(NamedTuple):
    """What one program is run with. Traced."""

    scene: Array | int  # [] place in `SCENES`
    bucket: DraggedBucket


class Seen(NamedTuple):
    """What trackers get of a run, and what they do not."""

    clouds: Scan  # [T, P]
    picked_m: Array  # [3, 2] the centroids nearest to the target in the first frames
    stand_m: Array  # [T, 2] where navigation has the vehicle in the middle of a sweep
    truth: Truth
    overflow: Array  # [] more points than places in a sweep


class Run(NamedTuple):
    """What one trial simulates."""

    seen: Seen
    draw: Key  # of the trackers


class Track(NamedTuple):
    """What a tracker says, look by look, from the fourth on."""

    position_m: Array  # [T − 3, 2]
    particles_m: Array  # [T − 3, N, 2]
    overflow: Array  # [T − 3]


class Outcome(NamedTuple):
    """What one trial gives, by method in the order of `METHODS`."""

    error_m: Array  # [M, T − 3, 2] truth less estimate, when the beam crosses the target
    crossed: Array  # [T − 3] it does
    away: Array  # [T − 3, 2] unit vectors from the vehicle to the target
    overflow: Array  # [M] more points around the particles than places, in any sweep
    crowded: Array  # [] more points in a sweep than places


def trial(key: Key, inputs: Inputs) -> Outcome:
    """Return the errors of all trackers in one run."""
    run = begin(key, inputs)
    seen, tracks = run.seen, track_all(run)
    sight_m = seen.truth.state[FIRST:, 0, :2] - seen.stand_m[FIRST:]
    return Outcome(
        jnp.stack([_error_m(run, tracks[name]) for name in METHODS]),
        seen.truth.mask[FIRST:, 0],
        sight_m / safe_norm(sight_m)[:, None],
        jnp.stack([tracks[name].overflow.any() for name in METHODS]),
        seen.overflow,
    )


def begin(key: Key, inputs: Inputs) -> Run:
    """Return what a run shows, and the key of its trackers."""
    return Run(look(jax.random.fold_in(key, 0), inputs), jax.random.fold_in(key, 1))


def bucket(key: Key, *, motion: Any, surroundings: Any, **numbers: Any) -> Run:
    """Return sweeps of a sonar that passes a bucket.

    Args:
        key: random key.
        motion: place in `sensors.MOTIONS`; a number, so that one program serves all.
        surroundings: place in `sensors.SURROUNDINGS`.
        numbers: of `sensors.DraggedBucket`.
    """
    place = jnp.asarray(motion * len(SURROUNDINGS) + surroundings).astype(jnp.int32)
    return begin(key, jax.tree.map(jnp.asarray, Inputs(place, DraggedBucket(**numbers))))


def look(key: Key, inputs: Inputs) -> Seen:
    """Return the clouds of a run, and where the operator picks the target."""
    sonar = IMAGENEX_881L.sonar
    scenes = [
        functools.partial(dragged_bucket, motion=motion, surroundings=around, frames=FRAMES)
        for motion, around in SCENES
    ]
    run = jax.lax.switch(
        inputs.scene, [lambda key, b, f=f: f(key, scene=b) for f in scenes], key, inputs.bucket
    )
    clouds, overflow = jax.lax.map(lambda pings: cloud_of_pings(pings, sonar), run.pings)
    # The operator needs the first sweeps alone.
    early = jax.tree.map(lambda x: x[:FIRST], run.pings)
    found = jax.lax.map(lambda pings: detect_in_pings(pings, sonar)[0], early)
    gap_m = safe_norm(found.position_m - run.truth.state[:FIRST, :1, :2])
    nearest = jnp.argmin(jnp.where(found.mask, gap_m, jnp.inf), axis=1)
    picked_m = jnp.take_along_axis(found.position_m, nearest[:, None, None], axis=1)[:, 0]
    middle = run.pings.pose.position_m.shape[1] // 2
    stand_m = run.pings.pose.position_m[:, middle]
    return Seen(clouds, picked_m, stand_m, run.truth, overflow.any())


def track_all(run: Run, kinds: tuple[str, ...] = tuple(FEATURES)) -> dict[str, Track]:
    """Return what trackers say of the same clouds, by method: those of some kinds, and ours."""
    tracks = {}
    for name in kinds:
        one = lambda optimised, name=name: moments(run, features=name, optimised=optimised)
        both = jax.lax.map(one, jnp.array([False, True]))  # the transitions, in one program
        for place, word in enumerate(("", OPTIMISED)):
            tracks[name + word] = jax.tree.map(lambda x, k=place: x[k], both)
    tracks[OURS] = shape(run)
    return tracks


def moments(run: Run, *, features: str, optimised: Any) -> Track:
    """Return the track of the paper's tracker.

    Args:
        run: what it sees.
        features: one of `FEATURES`, static.
        optimised: 1: its second transition, 0: the first.
    """
    optimised = jnp.asarray(optimised).astype(bool)
    kind, origin = FEATURES[features]
    first, later = _parts(run.seen.clouds)
    template = moment_template(first, run.seen.picked_m, features=kind, origin=origin)
    tracker = moment_tracker(
        template, run.seen.picked_m[-2:], features=kind, origin=origin, optimised=optimised
    )
    draw = jax.random.fold_in(run.draw, list(FEATURES).index(features))
    _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.fold_in(draw, optimised)), later)
    return Track(info.position_m, info.particles, info.overflow)


def shape(run: Run) -> Track:
    """Return the track of our own tracker, which is told the bucket's size.

    The template is about the bucket's middle: behind the centroid, away from the vehicle.
    """
    first, later = _parts(run.seen.clouds)
    sight_m = run.seen.picked_m - run.seen.stand_m[:FIRST]
    middle_m = run.seen.picked_m + SIDE_M * sight_m / safe_norm(sight_m)[:, None]
    tracker = shape_tracker(shape_template(first, middle_m))
    draw = jax.random.fold_in(run.draw, len(FEATURES))
    _, info = jax.lax.scan(tracker.step, tracker.init(draw), later)
    return Track(info.position_m, info.particles[..., :2], info.overflow)


def s_m(run: Run, track: Track) -> Array:
    """Return S, the mean distance from where the target was when the beam crossed it."""
    return mean_gap_m(_error_m(run, track), run.seen.truth.mask[FIRST:, 0])


def lost(run: Run, track: Track) -> Array:
    """Return whether the last looks are far off."""
    return astray(_error_m(run, track))


def mean_gap_m(error_m: Array, crossed: Array) -> Array:
    """Return the mean distance over looks that cross the target, [...].

    Args:
        error_m: [..., T, 2].
        crossed: [..., T].
    """
    gap_m = jnp.where(crossed, safe_norm(error_m), 0.0)
    return safe_divide(gap_m.sum(-1), crossed.sum(-1).astype(gap_m.dtype))


def astray(error_m: Array) -> Array:
    """Return whether runs are lost, [...]; `error_m` is [..., T, 2]."""
    return safe_norm(error_m[..., -LAST:, :]).mean(-1) > FAR_M


def _error_m(run: Run, track: Track) -> Array:
    return run.seen.truth.state[FIRST:, 0, :2] - track.position_m


def _parts(clouds: Scan) -> tuple[Scan, Scan]:
    """Return the clouds that templates come from, and those that are tracked."""
    return jax.tree.map(lambda x: x[:FIRST], clouds), jax.tree.map(lambda x: x[FIRST:], clouds)
