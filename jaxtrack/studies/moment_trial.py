"""One trial of the study `moment_tracking`: a bucket, its sweeps, and every tracker on them.

Scene, speed and distances are traced: every cell of every table is the same compiled program.
"""

import functools
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.safe import safe_norm
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
    seen = look(jax.random.fold_in(key, 0), inputs)
    tracks = track_all(jax.random.fold_in(key, 1), seen)
    at_m = seen.truth.state[FIRST:, 0, :2]
    sight_m = at_m - seen.stand_m[FIRST:]
    return Outcome(
        jnp.stack([at_m - tracks[name].position_m for name in METHODS]),
        seen.truth.mask[FIRST:, 0],
        sight_m / safe_norm(sight_m)[:, None],
        jnp.stack([tracks[name].overflow.any() for name in METHODS]),
        seen.overflow,
    )


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


def track_all(key: Key, seen: Seen, kinds: tuple[str, ...] = tuple(FEATURES)) -> dict[str, Track]:
    """Return what trackers say of the same clouds, by method: those of some kinds, and ours."""
    first = jax.tree.map(lambda x: x[:FIRST], seen.clouds)
    later = jax.tree.map(lambda x: x[FIRST:], seen.clouds)
    tracks = {}
    for name in kinds:
        draw = jax.random.fold_in(key, list(FEATURES).index(name))
        one = functools.partial(_paper, draw, seen, first, later, name)
        both = jax.lax.map(one, jnp.array([False, True]))  # the transitions, in one program
        for place, word in enumerate(("", OPTIMISED)):
            tracks[name + word] = jax.tree.map(lambda x, k=place: x[k], both)
    tracks[OURS] = _ours(jax.random.fold_in(key, len(FEATURES)), seen, first, later)
    return tracks


def _paper(key: Key, seen: Seen, first: Scan, later: Scan, name: str, optimised: Array) -> Track:
    """Return the track of the paper's tracker, with one kind of features."""
    features, origin = FEATURES[name]
    template = moment_template(first, seen.picked_m, features=features, origin=origin)
    tracker = moment_tracker(
        template, seen.picked_m[-2:], features=features, origin=origin, optimised=optimised
    )
    draw = jax.random.fold_in(key, optimised)
    _, info = jax.lax.scan(tracker.step, tracker.init(draw), later)
    return Track(info.position_m, info.particles, info.overflow)


def _ours(key: Key, seen: Seen, first: Scan, later: Scan) -> Track:
    """Return the track of our own tracker, which is told the bucket's size.

    The template is about the bucket's middle: behind the centroid, away from the vehicle.
    """
    sight_m = seen.picked_m - seen.stand_m[:FIRST]
    middle_m = seen.picked_m + SIDE_M * sight_m / safe_norm(sight_m)[:, None]
    tracker = shape_tracker(shape_template(first, middle_m))
    _, info = jax.lax.scan(tracker.step, tracker.init(key), later)
    return Track(info.position_m, info.particles[..., :2], info.overflow)
