"""Steps of the Kalman tracker agree with Stone Soup's on the same looks."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.filtering.gaussian import Moments
from jaxtrack.tracking import KalmanTrackerParams, LifecycleParams, kalman_tracker
from jaxtrack.types import Scan, Stage

pytest.importorskip("stonesoup")

from tests.oracles import stone_soup

SIGMA, SIGMA_A, P_DETECT, CLUTTER, GATE = 1.0, 0.25, 0.85, 4e-3, 9.21
LOOKS, PLACES = 10, 12
PAIRS = {"greedy": "nn", "optimal": "gnn", "pda": "pda", "jpda": "jpda"}
# Nobody is deleted: a full table of tracks stays what it is, and no detection starts one.
FOREVER = LifecycleParams(delete_misses=1000, delete_tentative_misses=1000)
PARAMS = KalmanTrackerParams(SIGMA, SIGMA_A, P_DETECT, CLUTTER, gate=GATE, lifecycle=FOREVER)


def scene(seed, tracks):
    """Return looks at targets that meet in the middle, in clutter, and the tracks before them."""
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.integers(6, 11, LOOKS)) / 8  # microseconds hold eighths exactly
    middle, velocity = time_s[LOOKS // 2], rng.uniform(-3.0, 3.0, (tracks, 2))
    start = np.array([20.0, 20.0]) + 2.5 * rng.normal(size=(tracks, 2)) - middle * velocity
    position = rng.uniform(5.0, 35.0, (LOOKS, PLACES, 2))
    mask = rng.random((LOOKS, PLACES)) < 0.5
    for n in range(tracks):
        position[:, n] = start[n] + time_s[:, None] * velocity[n] + rng.normal(size=(LOOKS, 2))
        mask[:, n] = rng.random(LOOKS) < P_DETECT
    position[~mask] = np.nan
    mean = np.concatenate([start, velocity], axis=1) + 0.5 * rng.normal(size=(tracks, 4))
    root = np.diag([1.0, 1.0, 0.5, 0.5]) + 0.2 * rng.normal(size=(tracks, 4, 4))
    covariance = root @ root.swapaxes(1, 2)
    return Scan(time_s, np.ones(LOOKS, bool), position, mask), mean, covariance  # pyright: ignore


@functools.cache
def compiled(name, tracks):
    tracker = kalman_tracker(PARAMS, max_tracks=tracks, associator=name)

    def run(scans, mean, covariance):
        state = tracker.init(jax.random.key(0))
        table = state.table
        begun = table.tracks._replace(
            mean=mean,
            covariance=covariance,
            mask=jnp.ones(tracks, bool),
            identity=jnp.arange(tracks, dtype=jnp.int32),
            stage=jnp.full(tracks, Stage.CONFIRMED, jnp.int32),
        )
        state = state._replace(
            table=table._replace(tracks=begun), beliefs=Moments(mean, covariance)
        )
        return jax.lax.scan(tracker.step, state, scans)[1]

    return jax.jit(run)


@pytest.mark.parametrize("name", PAIRS)
def test_steps_agree(name):
    peer = stone_soup.Setup(
        PAIRS[name], sigma=SIGMA, sigma_a=SIGMA_A, p_detect=P_DETECT, clutter=CLUTTER, gate=GATE
    )
    shared = 0
    for seed, tracks in enumerate((2, 5, 5)):
        scans, mean, covariance = scene(seed, tracks)
        info = compiled(name, tracks)(scans, mean, covariance)
        theirs = [stone_soup.track(*one, 0.0) for one in zip(mean, covariance, strict=True)]
        for k, time_s in enumerate(scans.time_s):
            places = scans.position_m[k][scans.mask[k]]
            peer.look(set(theirs), peer.detections(places, time_s), time_s)
            states = [one.state for one in theirs]
            expected = np.array([np.ravel(state.state_vector) for state in states], float)
            spread = np.array([state.covar for state in states], float)
            np.testing.assert_allclose(info.tracks.mean[k], expected, rtol=0, atol=1e-9)
            np.testing.assert_allclose(info.tracks.covariance[k], spread, rtol=0, atol=1e-9)
        weight = np.asarray(info.weight)
        shared += int(((weight > 0.05).sum(1) > 1).sum() + ((weight > 0.05).sum(2) == 0).sum())
    assert shared > 3  # detections that two tracks want, and tracks that got none
