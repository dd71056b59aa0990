"""One trial of the study `ccm`: two targets meet, and every associator tracks the same looks.

Situation, source of the looks and what is known of it are traced: every cell of every table is the
same compiled program.
"""

from typing import NamedTuple

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
from jaxtrack.sensors import Situation
from jaxtrack.studies.ccm_looks import LOOKS, Contents, Known, Looks, contents, looks_of, seen_at
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
    source: Array | int  # [] place in `ccm_looks.SOURCES`
    known: Known
    least_clutter_per_m2: Array | float  # β₀: what associators assume where there is less


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


class Run(NamedTuple):
    """One run with all that happened in it."""

    looks: Looks
    mean: dict[str, Array]  # [T, 2, 4] by associator
    covariance: dict[str, Array]  # [T, 2, 4, 4]


class _Tracks(NamedTuple):
    """Two tracks of an associator."""

    mean: Array  # [2, 4]
    covariance: Array  # [2, 4, 4]
    time: Array  # [2] of each, in looks


def trial(key: Key, inputs: Inputs) -> Outcome:
    """Return the scores of all associators in one run."""
    looks, mean, covariance = simulate(key, inputs)
    state = looks.truth.state
    each = jax.vmap(jax.vmap(lambda *x: nees(*x).squared))

    def score(name: str) -> Scores:
        verdict = swap_and_loss(mean[name][..., :2], state[..., :2])
        apart = (mean[name] - state)[..., :2]
        agreed = each(mean[name], covariance[name], state).mean()
        return Scores(verdict.swap, verdict.loss, (apart**2).sum(-1).mean(-1), agreed)

    scores = {name: score(name) for name in METHODS}
    paths_m = {name: mean[name][..., :2] for name in SHOWN}
    return Outcome(scores, paths_m, contents(looks), looks.overflow)


def look(key: Key, inputs: Inputs) -> Looks:
    """Return the looks of one run alone."""
    path, seen, _, _ = jax.random.split(key, 4)
    return looks_of(path, seen, inputs.situation, jnp.asarray(inputs.source))


def simulate(key: Key, inputs: Inputs) -> Run:
    """Return one run: looks, and the tracks of all associators, known in the first look.

    Each track moves to when the sensor comes to see the place where the middle of the look has it.
    """
    _, _, start, draws = jax.random.split(key, 4)
    known, looks = inputs.known, look(key, inputs)
    begin = looks.truth.state[0]
    dtype = begin.dtype
    variance = jnp.asarray(START_VARIANCE, dtype)
    noise = jnp.sqrt(variance)[None] * jax.random.normal(start, (2, 4), dtype)
    turning = looks.middle, looks.turn_per_rad, looks.pose
    at_first = seen_at(begin[:, :2], *jax.tree.map(lambda x: x[0], turning))
    one = _Tracks(begin + noise, jnp.broadcast_to(jnp.diag(variance), (2, 4, 4)), at_first)
    r = jnp.diag(jnp.asarray(known.spread_m, dtype) ** 2)
    clutter = jnp.asarray(known.clutter_per_m2, dtype)
    least = jnp.asarray(inputs.least_clutter_per_m2, dtype)
    params = AssociationParams(
        known.p_detect, jnp.where(clutter > least, clutter, least), GATE, known.echoes
    )
    area_m2 = 4 * jnp.pi * jnp.sqrt(r[0, 0] * r[1, 1])
    others = (jnp.asarray(known.echoes, dtype) - 1) / area_m2

    def move(mean: Array, covariance: Array, dt: Array) -> gaussian.Moments:
        added = white_noise_acceleration(dt, SIGMA_A_M)
        return gaussian.predict(mean, covariance, transition_matrix(dt), added)

    def associated(name: str, mean: Array, covariance: Array, seen: Scan, origin: Array, key: Key):
        predicted = predict_measurement(mean, covariance, r)
        if name == KNOWN:
            own = (origin[None, :] == jnp.arange(2, dtype=jnp.int32)[:, None]).astype(dtype)
            weights = Association(own, 1 - own.max(-1), jnp.asarray(True))
            return update_centroid(mean, covariance, predicted, seen, weights)
        here, method = params, ASSOCIATORS["jpda" if name == MORE_CLUTTER else name]
        if name == MORE_CLUTTER:
            # A target's other echoes are clutter to a rule of one detection a target.
            here = params._replace(clutter_per_m2=params.clutter_per_m2 + others)
        found = method.associate(predicted, seen, here, key)
        return method.update(mean, covariance, predicted, seen, found)

    def step(tracks: dict[str, _Tracks], at: tuple[Scan, Array, Key, tuple]):
        seen, origin, key, turning = at
        # All moved at once: a program of its own for each takes long to compile.
        before = [tracks[name] for name in METHODS]  # a dict comes back in another order
        every = _Tracks(*(jnp.stack(x) for x in zip(*before, strict=True)))
        middle = propagate(every.mean, turning[0] - every.time)
        time = seen_at(middle[..., :2], *turning)
        moved = jax.vmap(jax.vmap(move))(every.mean, every.covariance, time - every.time)
        after = {}
        for place, (name, (mean, covariance)) in enumerate(
            zip(METHODS, zip(*moved, strict=True), strict=True)
        ):
            found = associated(name, mean, covariance, seen, origin, key)
            after[name] = _Tracks(*found, time[place])
        return after, after

    keys = jax.random.split(draws, LOOKS)
    each = looks.scans, looks.origin, keys, turning
    _, found = jax.lax.scan(step, dict.fromkeys(METHODS, one), each)
    mean, covariance = ({name: found[name][k] for name in METHODS} for k in (0, 1))
    return Run(looks, mean, covariance)
