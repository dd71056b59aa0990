"""Births where targets give several echoes a look: one a neighbourhood, and no second track."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.association import ASSOCIATORS
from jaxtrack.filtering.gaussian import Moments
from jaxtrack.hough import SpeedGate
from jaxtrack.tracking import KalmanTrackerParams, kalman_tracker, soft_lives, track
from jaxtrack.tracking.births import one_a_neighbourhood
from jaxtrack.types import Scan, Stage
from tests.oracles import births as oracle

PLACES, LOOKS, LIMIT = 12, 16, 9.21
SEVERAL = [name for name, method in ASSOCIATORS.items() if method.several]
starting = jax.jit(one_a_neighbourhood)


def problem(seed):
    """Return detections, some in groups, of covariances of their own; what is masked is NaN."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(0.0, 25.0, (4, 2))
    mean = np.zeros((PLACES, 4))
    mean[:, :2] = centres[rng.integers(0, 4, PLACES)] + rng.normal(size=(PLACES, 2))
    root = rng.normal(size=(PLACES, 4, 4)) / 2
    covariance = root @ root.swapaxes(1, 2) + 0.5 * np.eye(4)
    mask, weight = rng.random(PLACES) < 0.8, rng.uniform(0.2, 1.0, PLACES)
    mean[~mask], covariance[~mask], weight[~mask] = np.nan, np.nan, np.nan
    return Moments(mean, covariance), weight, mask


def test_those_that_start_are_the_oracles():
    for seed in range(20):
        started, weight, mask = problem(seed)
        got = np.flatnonzero(starting(started, weight, mask, LIMIT))
        place, spread = started.mean[:, :2], started.covariance[:, :2, :2]
        assert got.tolist() == oracle.starts(place, spread, weight, mask, LIMIT)
        assert 0 < len(got) < mask.sum()


def test_order_and_padding_change_nothing_and_equal_echoes_are_told_by_their_place():
    for seed in range(5):
        started, weight, mask = problem(seed)
        if seed == 0:  # a pair supports each other equally
            started.mean[:2, :2], started.covariance[:2] = [[50.0, 1.0], [50.0, 0.0]], np.eye(4)
            weight[:2], mask[:2] = 1.0, True
            assert starting(started, weight, mask, LIMIT)[:2].tolist() == [False, True]
        order = np.random.default_rng(seed).permutation(PLACES)
        shuffled = jax.tree.map(lambda x, order=order: x[order], (started, weight, mask))
        got = starting(*shuffled, LIMIT)
        np.testing.assert_array_equal(got, starting(started, weight, mask, LIMIT)[order])
        pad = lambda x: np.concatenate(
            [x, np.zeros_like(x[:3]) + (0 if x.dtype == bool else np.nan)]
        )
        longer = jax.tree.map(pad, (started, weight, mask.astype(float)))
        longer = starting(longer[0], longer[1], longer[2] == 1, LIMIT)
        np.testing.assert_array_equal(longer[:PLACES], starting(started, weight, mask, LIMIT))
        assert not longer[PLACES:].any()


def test_vmap_is_a_loop_and_nothing_starts_where_nothing_is():
    several = [problem(seed) for seed in range(3)]
    stacked = jax.tree.map(lambda *x: np.stack(x), *several)
    got = jax.vmap(starting, (0, 0, 0, None))(*stacked, LIMIT)
    for n, one in enumerate(several):
        np.testing.assert_array_equal(got[n], starting(*one, LIMIT))
    started, weight, mask = several[0]
    assert not starting(started, weight, np.zeros_like(mask), LIMIT).any()
    with pytest.raises(ValueError, match=r"weight: got shape \[2\], want \[12\]"):
        one_a_neighbourhood(started, weight[:2], mask)


def looks(seed, *, echoes=5, clutter=2, looks=LOOKS):
    """Return looks at two targets of several echoes each, 25 m apart, in clutter."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(float(looks))
    places = 2 * echoes + clutter
    position = rng.uniform(0.0, 60.0, (looks, places, 2))
    mask = np.ones((looks, places), bool)
    path = np.stack([np.stack([10 + 2 * time_s, 15 + 25 * k + 0 * time_s], -1) for k in (0, 1)], 1)
    for target in (0, 1):
        own = slice(target * echoes, (target + 1) * echoes)
        position[:, own] = path[:, target, None] + 0.5 * rng.normal(size=(looks, echoes, 2))
        mask[:, own] = (rng.random((looks, echoes)) < 0.8) & (rng.random((looks, 1)) < 0.9)
    mask[:, 2 * echoes :] = rng.random((looks, clutter)) < 0.5
    return Scan(time_s, np.ones(looks, bool), position, mask), path  # pyright: ignore


@functools.cache
def compiled(name, soft=False):
    params = KalmanTrackerParams(0.5, 0.1, 0.9, 5e-4, birth_sigma_m_s=1.5, echoes=4.0)
    tracker = kalman_tracker(
        params, max_tracks=8, associator=name, lives=soft_lives() if soft else None
    )
    return jax.jit(lambda scans: jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans))


@pytest.mark.parametrize("name", SEVERAL)
def test_a_target_of_several_echoes_has_one_track(name):
    for seed in range(8):
        scans, path = looks(seed)
        _, info = compiled(name)(scans)
        stage, mean = np.asarray(info.tracks.stage), np.asarray(info.tracks.mean)
        confirmed = stage >= Stage.CONFIRMED
        off = np.linalg.norm(mean[:, :, None, :2] - path[:, None], axis=-1)  # [look, slot, target]
        near = confirmed[:, :, None] & (off < 3.0)
        assert near.sum(1).max() == 1  # never two of one target
        assert near[-1].any(0).all()  # and one of each in the end


def test_soft_lives_have_one_track_a_target_as_well():
    scans, path = looks(0)
    _, info = compiled("pmht", soft=True)(scans)
    off = np.asarray(info.tracks.mean)[:, :, None, :2] - path[:, None]
    near = np.linalg.norm(off, axis=-1) < 3.0
    share = np.where(near, np.asarray(info.tracks.existence)[:, :, None], 0.0).sum(1)
    assert share.max() < 1.1
    assert share[-1].min() > 0.8


@pytest.mark.parametrize("tracker", ["pmht", "cloud_averaged"])
def test_a_recording_of_targets_with_several_echoes_has_as_many_tracks(tracker):
    scans, path = looks(3)
    tracks, info = track(
        scans,
        tracker=tracker,
        speed=SpeedGate(0.0, 3.0),
        sigma_m=0.5,
        echoes=4.0,
        max_tracks=12,
    )
    assert info.notes == ()
    mask = np.asarray(tracks.mask)
    assert len(np.unique(np.asarray(tracks.identity)[mask])) == 2
    found = np.asarray(tracks.mean)[-1][mask[-1], :2]
    off = np.linalg.norm(found[:, None] - path[-1][None], axis=-1)
    assert sorted(off.argmin(1)) == [0, 1]
    assert off.min(1).max() < 1.0


def test_neighbourhoods_are_the_same_in_single_precision():
    started, weight, mask = problem(2)
    single = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), (started, weight))
    np.testing.assert_array_equal(
        starting(*single, mask, np.float32(LIMIT)), starting(started, weight, mask, LIMIT)
    )
