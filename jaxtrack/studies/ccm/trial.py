"""One trial of the study `ccm`: two targets meet, and every associator tracks the same looks.

Situation, source of the looks and what is known of it are traced: every cell of every table is the
same compiled program. Files of studies name the parts: the scene `meeting`, the method `associate`,
and the metrics.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.association import (
    ASSOCIATORS,
    Association,
    AssociationParams,
    predict_measurement,
    update_centroid,
)
from jaxtrack.filtering import gaussian
from jaxtrack.metrics import nees, swap_and_loss
from jaxtrack.models import propagate, transition_matrix, white_noise_acceleration
from jaxtrack.sensors import EchoSensor, Meeting, Situation
from jaxtrack.studies.ccm.looks import (
    LOOKS,
    SOURCES,
    Contents,
    Known,
    Looks,
    contents,
    known_of,
    looks_of,
    seen_at,
)
from jaxtrack.types import Array, Key, Scan

SIGMA_A_M = 0.1  # of the filter, m a look²; the targets' own is less
START_VARIANCE = (0.25, 0.25, 0.04, 0.04)  # m², (m a look)² of the tracks in the first look
GATE = 9.21
MORE_CLUTTER, KNOWN = "jpda_echoes", "known"
METHODS = (*ASSOCIATORS, MORE_CLUTTER, KNOWN)
SHOWN = ("nearest", "optimal", "jpda", "cloud", "cloud_averaged", "pmht")  # in figures


class Inputs(NamedTuple):
    """What one program is run with. Traced."""

    situation: Situation
    source: Array | int  # [] place in `ccm.looks.SOURCES`
    known: Known
    least_clutter_per_m2: Array | float  # β₀: what associators assume where there is less


class Seen(NamedTuple):
    """What one trial simulates."""

    inputs: Inputs
    looks: Looks
    start: Key  # of the tracks' first states
    draws: Key  # of associators that draw


class Paths(NamedTuple):
    """Two tracks of one associator."""

    mean: Array  # [T, 2, 4]
    covariance: Array  # [T, 2, 4, 4]


class Scores(NamedTuple):
    """How one associator fared in one run."""

    swap: Array  # []
    loss: Array  # []
    squared_m2: Array  # [T] squared distance, mean of the two tracks
    nees: Array  # [] mean over looks and tracks, of four states


class Outcome(NamedTuple):
    """What one trial gives."""

    scores: dict[str, Scores]  # by associator
    paths_m: dict[str, Array]  # [T, 2, 2] of those that are shown
    contents: Contents
    overflow: Array  # [] a look had more than its places hold


class _Tracks(NamedTuple):
    """Two tracks of an associator."""

    mean: Array  # [2, 4]
    covariance: Array  # [2, 4, 4]
    time: Array  # [2] of each, in looks


def trial(key: Key, inputs: Inputs) -> Outcome:
    """Return the scores of all associators in one run."""
    seen = begin(key, inputs)
    paths = associate_all(seen)
    scores = {name: score(seen, paths[name]) for name in METHODS}
    paths_m = {name: paths[name].mean[..., :2] for name in SHOWN}
    return Outcome(scores, paths_m, contents(seen.looks), seen.looks.overflow)


def begin(key: Key, inputs: Inputs) -> Seen:
    """Return the looks of one run, and the keys of the tracks."""
    _, _, start, draws = jax.random.split(key, 4)
    return Seen(inputs, look(key, inputs), start, draws)


def meeting(
    key: Key,
    *,
    angle_deg: Any,
    gap_m: Any,
    sigma_a_m_s2: Any,
    clutter_per_m2: Any,
    echoes: Any,
    least_clutter_per_m2: Any,
    source: str = SOURCES[0],
) -> Seen:
    """Return looks at two targets that meet.

    Args:
        key: random key.
        angle_deg: between their courses; 0: side by side.
        gap_m: between them where they meet.
        sigma_a_m_s2: acceleration.
        clutter_per_m2: drawn; a sonar has its own.
        echoes: of a detected target, drawn.
        least_clutter_per_m2: β₀: what associators assume where there is less.
        source: one of `ccm.looks.SOURCES`, static.
    """
    sensor = EchoSensor(clutter_per_m2=clutter_per_m2, echoes=echoes)
    situation = Situation(Meeting(angle_deg * (math.pi / 180), gap_m, sigma_a_m_s2), sensor)
    known = known_of(source, sensor)
    inputs = Inputs(situation, SOURCES.index(source), known, least_clutter_per_m2)
    return begin(key, jax.tree.map(jnp.asarray, inputs))


def associate(seen: Seen, *, rule: str) -> Paths:
    """Return the tracks of one of `METHODS`; static."""
    return associate_all(seen, (rule,))[rule]


def swapped_or_lost(seen: Seen, paths: Paths) -> Array:
    """Return whether the tracks are exchanged, or one is lost."""
    found = score(seen, paths)
    return found.swap | found.loss


def squared_m2(seen: Seen, paths: Paths) -> Array:
    """Return the mean squared distance over looks and tracks."""
    return score(seen, paths).squared_m2.mean()


def score(seen: Seen, paths: Paths) -> Scores:
    """Return how one associator fared."""
    mean, covariance = paths
    state = seen.looks.truth.state
    verdict = swap_and_loss(mean[..., :2], state[..., :2])
    apart = (mean - state)[..., :2]
    each = jax.vmap(jax.vmap(lambda *x: nees(*x).squared))
    agreed = each(mean, covariance, state).mean()
    return Scores(verdict.swap, verdict.loss, (apart**2).sum(-1).mean(-1), agreed)


def look(key: Key, inputs: Inputs) -> Looks:
    """Return the looks of one run alone."""
    path, seen, _, _ = jax.random.split(key, 4)
    return looks_of(path, seen, inputs.situation, jnp.asarray(inputs.source))


def associate_all(seen: Seen, names: tuple[str, ...] = METHODS) -> dict[str, Paths]:
    """Return the tracks of associators, known in the first look.

    Each track moves to when the sensor comes to see the place where the middle of the look has it.
    """
    known, looks = seen.inputs.known, seen.looks
    initial = looks.truth.state[0]
    dtype = initial.dtype
    variance = jnp.asarray(START_VARIANCE, dtype)
    noise = jnp.sqrt(variance)[None] * jax.random.normal(seen.start, (2, 4), dtype)
    turning = looks.middle, looks.turn_per_rad, looks.pose
    at_first = seen_at(initial[:, :2], *jax.tree.map(lambda x: x[0], turning))
    one = _Tracks(initial + noise, jnp.broadcast_to(jnp.diag(variance), (2, 4, 4)), at_first)
    r = jnp.diag(jnp.asarray(known.spread_m, dtype) ** 2)
    clutter = jnp.asarray(known.clutter_per_m2, dtype)
    least = jnp.asarray(seen.inputs.least_clutter_per_m2, dtype)
    params = AssociationParams(
        known.p_detect, jnp.where(clutter > least, clutter, least), GATE, known.echoes
    )
    area_m2 = 4 * jnp.pi * jnp.sqrt(r[0, 0] * r[1, 1])
    others = (jnp.asarray(known.echoes, dtype) - 1) / area_m2

    def move(mean: Array, covariance: Array, dt: Array) -> gaussian.Moments:
        added = white_noise_acceleration(dt, SIGMA_A_M)
        return gaussian.predict(mean, covariance, transition_matrix(dt), added)

    def associated(name: str, mean: Array, covariance: Array, scan: Scan, origin: Array, key: Key):
        predicted = predict_measurement(mean, covariance, r)
        if name == KNOWN:
            own = (origin[None, :] == jnp.arange(2, dtype=jnp.int32)[:, None]).astype(dtype)
            weights = Association(own, 1 - own.max(-1), jnp.asarray(True))
            return update_centroid(mean, covariance, predicted, scan, weights)
        here, method = params, ASSOCIATORS["jpda" if name == MORE_CLUTTER else name]
        if name == MORE_CLUTTER:
            # A target's other echoes are clutter to a rule of one detection a target.
            here = params._replace(clutter_per_m2=params.clutter_per_m2 + others)
        found = method.associate(predicted, scan, here, key)
        return method.update(mean, covariance, predicted, scan, found)

    def step(tracks: dict[str, _Tracks], at: tuple[Scan, Array, Key, tuple]):
        scan, origin, key, turning = at
        # All moved at once: a program of its own for each takes long to compile.
        before = [tracks[name] for name in names]  # a dict comes back in another order
        every = _Tracks(*(jnp.stack(x) for x in zip(*before, strict=True)))
        middle = propagate(every.mean, turning[0] - every.time)
        time = seen_at(middle[..., :2], *turning)
        moved = jax.vmap(jax.vmap(move))(every.mean, every.covariance, time - every.time)
        after = {}
        for place, (name, (mean, covariance)) in enumerate(
            zip(names, zip(*moved, strict=True), strict=True)
        ):
            found = associated(name, mean, covariance, scan, origin, key)
            after[name] = _Tracks(*found, time[place])
        return after, after

    keys = jax.random.split(seen.draws, LOOKS)
    each = looks.scans, looks.origin, keys, turning
    _, found = jax.lax.scan(step, dict.fromkeys(names, one), each)
    return {name: Paths(*found[name][:2]) for name in names}
