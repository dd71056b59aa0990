"""Soft lives against their loop, and against the hard ones that they tend to."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.tracking.lifecycle import Births, LifecycleParams, admit, empty_table, grade
from jaxtrack.tracking.soft_lifecycle import (
    Softness,
    check_softness,
    soft_admit,
    soft_empty_table,
    soft_grade,
)
from tests.metrics.differences import assert_gradients_agree
from tests.oracles.soft_lifecycle import SoftTrack

SLOTS, LAST, LOOKS = 3, 4, 12
LIVES = LifecycleParams(2, 1.0, 3, 2, 6)


def births(dtype=np.float64):
    eye = np.broadcast_to(np.eye(2, dtype=dtype), (SLOTS, 2, 2))
    zeros = np.zeros(SLOTS, dtype)
    return Births(*map(jnp.asarray, (np.ones((SLOTS, 2), dtype), eye, np.ones(SLOTS, bool), zeros)))


@jax.jit
def run(share, hits, counted, valid, scores, lives, softness):
    """Return existences [T, M] and masks of tracks that all start at first."""

    def step(soft, look):
        hit, counted, valid, score = look
        tracks = soft.table.tracks._replace(log_score=score)
        soft = soft._replace(table=soft.table._replace(tracks=tracks))
        soft = soft_grade(soft, hit, counted, valid, lives, softness)
        tracks = soft.table.tracks
        return soft, (tracks.existence, tracks.mask, tracks.stage)

    begin = soft_empty_table(share[0] * 0, tracks=SLOTS, state=2, looks=LAST)
    begin, _ = soft_admit(begin, births(share.dtype), share, lives)
    return jax.lax.scan(step, begin, (hits, counted, valid, scores))[1]


def looks(seed, dtype=np.float64):
    rng = np.random.default_rng(seed)
    hits = rng.beta(0.6, 0.4, (LOOKS, SLOTS)).astype(dtype)
    counted, valid = rng.random((LOOKS, SLOTS)) < 0.8, rng.random(LOOKS) < 0.9
    scores = np.cumsum(rng.normal(0.5, 1.0, (LOOKS, SLOTS)), axis=0).astype(dtype)
    return hits, counted, valid, scores


@pytest.mark.parametrize("seed", range(8))
def test_it_does_what_a_loop_over_tracks_does(seed):
    share = np.array([1.0, 0.9, 0.7])
    case = looks(seed)
    existence, mask, _ = run(share, *case, LIVES, Softness())
    tracks = [SoftTrack(LAST, alive) for alive in share]
    there = [True] * SLOTS
    for k in range(LOOKS):
        for slot, track in enumerate(tracks):
            if there[slot]:
                at = [x[k, slot] for x in (case[0], case[1])]
                there[slot] = track.look(*at, case[2][k], case[3][k, slot], LIVES, (0.25, 1.0))
            expected = track.alive * track.confirmed if there[slot] else 0.0
            np.testing.assert_allclose(existence[k, slot], expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(mask[k], there)


def test_it_tends_to_the_hard_lives():
    @jax.jit
    def hard(hits, counted, valid, scores):
        def step(table, look):
            hit, counted, valid, score = look
            table = table._replace(tracks=table.tracks._replace(log_score=score))
            table = grade(table, hit > 0.5, counted, valid, LIVES)
            return table, (table.tracks.mask, table.tracks.stage)

        begin = empty_table(jnp.zeros(()), tracks=SLOTS, state=2, looks=LAST)
        begin = admit(begin, births(), LIVES).table
        return jax.lax.scan(step, begin, (hits, counted, valid, scores))[1]

    apart = []
    for seed in range(20):
        hits, *rest = looks(seed)
        sure = np.round(hits)
        mask, stage = hard(sure, *rest)
        confirmed = np.asarray(stage >= 2)
        widths = [Softness(*(f * w for w in Softness())) for f in (1.0, 0.3, 1e-4)]
        found = [run(np.ones(SLOTS), sure, *rest, LIVES, width) for width in widths]
        apart.append([np.abs(np.asarray(existence) - confirmed).max() for existence, *_ in found])
        np.testing.assert_array_equal(found[2][1], mask)
        np.testing.assert_array_equal(found[2][2], stage)
    assert np.max(apart, axis=0)[2] < 1e-9
    assert np.mean(apart, axis=0)[0] > np.mean(apart, axis=0)[1] > 1e-4


def test_jitted_gradients_equal_differences():
    hits, counted, valid, scores = looks(3)

    def loss(hits, scores, share, hit_count, level, misses, width):
        lives = LIVES._replace(confirm_hits=hit_count, confirm_score=level, delete_misses=misses)
        softness = Softness(looks=width)
        return run(share, hits, counted, valid, scores, lives, softness)[0].sum()

    share = np.array([1.0, 0.9, 0.7])
    gradients = assert_gradients_agree(loss, hits, scores, share, 2.0, 1.0, 3.0, 0.3, rtol=1e-5)
    assert all(np.abs(g).max() > 1e-3 for g in gradients)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("level", [-np.inf, np.inf, 0.0])
def test_values_and_slopes_are_finite_and_of_one_precision(dtype, level):
    hits, counted, valid, scores = looks(5, dtype)
    number = lambda x: jnp.asarray(x, dtype)

    def loss(hits, scores, share, width, level):
        lives, softness = LIVES._replace(confirm_score=level), Softness(0.1, width, width, 1.0)
        return run(share, hits, counted, valid, scores, lives, softness)[0].sum()

    slopes = jax.jit(jax.value_and_grad(loss, argnums=(0, 1, 2, 3)))
    for case in (hits, np.ones_like(hits), np.zeros_like(hits)):
        found = slopes(case, scores, jnp.ones(SLOTS, dtype), number(0.25), number(level))
        for leaf in jax.tree.leaves(found):
            assert leaf.dtype == dtype
            assert np.isfinite(leaf).all()


def test_a_width_has_to_be_positive():
    with pytest.raises(ValueError, match=r"softness\.looks"):
        check_softness(Softness(looks=0.0))
