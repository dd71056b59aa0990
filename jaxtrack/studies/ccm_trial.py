"""One trial of the study `ccm`: two targets meet, and every associator tracks the same looks.

Situation and assumed clutter are traced: every cell of every table is the same compiled program.
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
from jaxtrack.models import transition_matrix, white_noise_acceleration
from jaxtrack.sensors import EchoLooks, Situation, meeting_targets, observe_echoes
from jaxtrack.types import Array, Key, Scan, Truth

LOOKS = 24
DT_S = 1.0
SIGMA_A_M_S2 = 0.1  # of the filter; the targets' own is less
START_VARIANCE = (0.25, 0.25, 0.04, 0.04)  # m², m²/s² of the tracks in the first look
GATE = 9.21
ECHOES, CLUTTER = 28, 80  # places in a look
MORE_CLUTTER, KNOWN = "jpda_echoes", "known"
METHODS = (*ASSOCIATORS, MORE_CLUTTER, KNOWN)


class Inputs(NamedTuple):
    """What one program is run with. Traced."""

    situation: Situation
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
    overflow: Array  # a look had more than its places hold


class Run(NamedTuple):
    """One run with all that happened in it."""

    truth: Truth
    looks: EchoLooks
    mean: dict[str, Array]  # [T, 2, 4] by associator
    covariance: dict[str, Array]  # [T, 2, 4, 4]


def trial(key: Key, inputs: Inputs) -> Outcome:
    """Return the scores of all associators in one run."""
    truth, looks, mean, covariance = simulate(key, inputs)
    each = jax.vmap(jax.vmap(lambda *x: nees(*x).squared))

    def score(name: str) -> Scores:
        verdict = swap_and_loss(mean[name][..., :2], truth.state[..., :2])
        apart = (mean[name] - truth.state)[..., :2]
        agreed = each(mean[name], covariance[name], truth.state).mean()
        return Scores(verdict.swap, verdict.loss, (apart**2).sum(-1).mean(-1), agreed)

    return Outcome({name: score(name) for name in METHODS}, looks.overflow)


def simulate(key: Key, inputs: Inputs) -> Run:
    """Return one run: truth, looks, and the tracks of all associators, known in the first look."""
    path, look, start, draws = jax.random.split(key, 4)
    sensor = inputs.situation.sensor
    truth = meeting_targets(path, inputs.situation.meeting, looks=LOOKS)
    looks = observe_echoes(look, truth, sensor, echoes=ECHOES, clutter=CLUTTER)
    dtype = truth.state.dtype
    variance = jnp.asarray(START_VARIANCE, dtype)
    noise = jnp.sqrt(variance)[None] * jax.random.normal(start, (2, 4), dtype)
    transition = transition_matrix(jnp.asarray(DT_S, dtype))
    added = white_noise_acceleration(jnp.asarray(DT_S, dtype), SIGMA_A_M_S2)
    begin = truth.state[0] + noise, jnp.broadcast_to(jnp.diag(variance), (2, 4, 4))
    r = jnp.asarray(sensor.spread_m, dtype) ** 2 * jnp.eye(2, dtype=dtype)
    clutter = jnp.asarray(sensor.clutter_per_m2, dtype)
    least = jnp.asarray(inputs.least_clutter_per_m2, dtype)
    params = AssociationParams(
        sensor.p_detect, jnp.where(clutter > least, clutter, least), GATE, sensor.echoes
    )
    others = (jnp.asarray(sensor.echoes, dtype) - 1) / (4 * jnp.pi * r[0, 0])

    def associated(name: str, mean: Array, covariance: Array, seen: Scan, origin: Array, key: Key):
        predicted = predict_measurement(mean, covariance, r)
        if name == KNOWN:
            own = (origin[None, :] == jnp.arange(2)[:, None]).astype(dtype)
            weights = Association(own, 1 - own.max(-1), jnp.asarray(True))
            return update_centroid(mean, covariance, predicted, seen, weights)
        here, method = params, ASSOCIATORS["jpda" if name == MORE_CLUTTER else name]
        if name == MORE_CLUTTER:
            # A target's other echoes are clutter to a rule of one detection a target.
            here = params._replace(clutter_per_m2=params.clutter_per_m2 + others)
        found = method.associate(predicted, seen, here, key)
        return method.update(mean, covariance, predicted, seen, found)

    def step(tracks: dict[str, tuple[Array, Array]], at: tuple[Scan, Array, Key, Array]):
        seen, origin, key, first = at
        after = {}
        for name in METHODS:
            moved = jax.vmap(lambda m, p: gaussian.predict(m, p, transition, added))(*tracks[name])
            moved = gaussian.choose(first, tracks[name], tuple(moved))
            after[name] = associated(name, moved[0], moved[1], seen, origin, key)
        return after, after

    keys = jax.random.split(draws, LOOKS)
    first = jnp.arange(LOOKS) == 0
    _, tracks = jax.lax.scan(
        step, dict.fromkeys(METHODS, begin), (looks.scans, looks.origin, keys, first)
    )
    mean, covariance = ({name: tracks[name][k] for name in METHODS} for k in (0, 1))
    return Run(truth, looks, mean, covariance)
