"""Fading targets: weights with a slope, which tend to detections that are dropped."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.sensors import Fade, drop, fade
from jaxtrack.types import Scan
from tests.metrics.differences import assert_gradients_agree

TIME_S = np.arange(8.0) * 0.7
ORIGIN = np.array([[0, 1, -1, 0]] * 8)
SCANS = Scan(TIME_S, np.ones(8, bool), np.zeros((8, 4, 2)), np.ones((8, 4), bool))  # pyright: ignore
MIDDLE, LENGTH = np.array([2.0, 3.1]), np.array([1.9, 0.0])


def weight(middle, length, edge, time_s=TIME_S):
    return fade(SCANS._replace(time_s=time_s), ORIGIN, Fade(middle, length, edge)).weight


def test_weights_equal_the_loop():
    got = weight(MIDDLE, LENGTH, 0.3)
    level = lambda x: 1.0 / (1.0 + np.exp(-x / 0.3))
    for t, n in np.ndindex(8, 4):
        k = ORIGIN[t, n]
        since = TIME_S[t] - MIDDLE[k]
        expected = 1.0 - level(since + LENGTH[k] / 2) + level(since - LENGTH[k] / 2)
        np.testing.assert_allclose(got[t, n], expected if k >= 0 else 1.0, atol=1e-14)
    np.testing.assert_array_equal(got[:, 1], 1.0)  # a gap of no length


def test_gradients_equal_differences_and_are_finite_far_away():
    scale = np.random.default_rng(0).normal(size=(8, 4))
    loss = lambda *numbers: (scale * weight(*numbers)).sum()
    gradients = assert_gradients_agree(loss, MIDDLE, LENGTH + 0.4, 0.3, atol=1e-8)
    assert all(np.abs(g).max() > 1e-3 for g in gradients)
    for numbers in (
        (MIDDLE * 1e9, LENGTH, 0.3),
        (MIDDLE, LENGTH * 1e9, 1e-9),
        (MIDDLE, LENGTH, 0.0),
    ):
        assert all(
            np.isfinite(g).all()
            for g in jax.jit(jax.grad(loss, (0, 1, 2)))(*map(jnp.asarray, numbers))
        )


def test_sharp_fades_are_gaps_and_dropping_is_what_the_weights_say():
    sharp = fade(SCANS, ORIGIN, Fade(MIDDLE, LENGTH, 1e-6))
    inside = np.abs(TIME_S[:, None] - MIDDLE[None, :]) < LENGTH[None, :] / 2
    gone = np.where(ORIGIN >= 0, np.take_along_axis(inside, np.maximum(ORIGIN, 0), 1), False)
    np.testing.assert_allclose(sharp.weight, 1.0 - gone, atol=1e-9)
    got = drop(jax.random.key(0), sharp)
    np.testing.assert_array_equal(got.mask, ~gone)
    assert got.weight is None
    soft = fade(SCANS, ORIGIN, Fade(MIDDLE, LENGTH, 0.5))
    keys = jax.random.split(jax.random.key(1), 4000)
    share = jax.vmap(lambda key: drop(key, soft).mask)(keys).mean(0)
    np.testing.assert_allclose(share, soft.weight, atol=0.04)  # five deviations
    hidden = soft._replace(mask=np.zeros((8, 4), bool))
    assert not drop(jax.random.key(0), hidden).mask.any()


def test_single_precision_stays_single():
    single = jax.tree.map(lambda x: x.astype(np.float32) if x.dtype == float else x, SCANS)
    got = fade(single, ORIGIN, Fade(MIDDLE.astype(np.float32), LENGTH.astype(np.float32), 0.3))
    assert got.weight.dtype == np.float32
    np.testing.assert_allclose(got.weight, weight(MIDDLE, LENGTH, 0.3), atol=1e-5)


def test_what_cannot_be_is_named():
    with pytest.raises(ValueError, match=r"fades\.edge_s: got 0\.0, want a positive"):
        fade(SCANS, ORIGIN, Fade(MIDDLE, LENGTH, 0.0))
    with pytest.raises(ValueError, match=r"fades\.length_s: got shape"):
        fade(SCANS, ORIGIN, Fade(MIDDLE, LENGTH[:1]))
    with pytest.raises(ValueError, match=r"scans\.weight: got weights"):
        fade(SCANS._replace(weight=np.ones((8, 4))), ORIGIN, Fade(MIDDLE, LENGTH))
    with pytest.raises(ValueError, match=r"scans\.weight: got None"):
        drop(jax.random.key(0), SCANS)
