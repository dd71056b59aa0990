"""Hu's invariants: against loops, OpenCV, and what they stay under."""

import chex
import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack import moments
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import moments as oracle

P = 12
POWERS = np.array([2, 4, 6, 6, 12, 8, 12])  # of lengths in I1 to I7
several = settings(max_examples=25, deadline=None, derandomize=True, database=None)
run = jax.jit(moments.hu)


def cloud(seed, kind="plain"):
    rng = np.random.default_rng(seed)
    # Wide against the weights, so that no invariant is small.
    xy, weight = 3.0 * rng.exponential(size=(P, 2)), rng.uniform(0.2, 2.0, P)
    if kind == "holes":
        xy[0], xy[1, 1], weight[2], weight[3], weight[4] = np.nan, np.inf, 0.0, np.nan, -1.0
    if kind == "alike":
        xy[:] = xy[0]
    if kind == "line":
        xy[:, 1] = xy[:, 0]
    if kind == "one":
        weight[1:] = 0.0
    if kind == "none":
        weight[:] = 0.0
    return xy, weight


KINDS = ("plain", "holes", "alike", "line", "one", "none")


@several
@given(st.builds(cloud, st.integers(0, 2**32 - 1), st.sampled_from(KINDS)))
def test_invariants_equal_the_loops(points):
    np.testing.assert_allclose(run(*points), oracle.hu(*points), rtol=1e-9, atol=1e-14)


def test_images_agree_with_opencv():
    of_image = jax.jit(moments.hu_image)
    for seed in range(30):
        rng = np.random.default_rng(seed)
        image = np.where(rng.random((24, 17)) < 0.3, rng.uniform(0.0, 5.0, (24, 17)), 0.0)
        expected = cv2.HuMoments(cv2.moments(image)).ravel()
        np.testing.assert_allclose(of_image(image), expected, rtol=1e-9)


def test_moving_turning_and_scaling():
    xy, weight = cloud(1)
    base = np.asarray(run(xy, weight))
    assert np.abs(base).min() > 1e-6
    for angle in (0.4, 2.1, -3.0):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        np.testing.assert_allclose(run(xy @ turn.T, weight), base, rtol=1e-11)
    np.testing.assert_allclose(run(xy + np.array([40.0, -7.0]), weight), base, rtol=1e-10)
    mirrored = base * np.array([1, 1, 1, 1, 1, 1, -1])
    np.testing.assert_allclose(run(xy * [1.0, -1.0], weight), mirrored, rtol=1e-12)
    np.testing.assert_allclose(run(3 * xy, 9 * weight), base, rtol=1e-12)
    np.testing.assert_allclose(run(3 * xy, weight), base * 3.0**POWERS, rtol=1e-12)
    np.testing.assert_allclose(run(xy, 9 * weight), base * 3.0**-POWERS, rtol=1e-12)


def test_weights_times_area_do_not_depend_on_the_density_of_points():
    found, bare = [], []
    for step in (0.02, 0.01):
        axis = np.arange(step / 2, 1.0, step)
        x, y = (grid.ravel() for grid in np.meshgrid(axis, axis))
        keep = x + 2 * y < 1.5
        xy, value = np.stack([x, y], -1)[keep], 1 + x[keep]
        found.append(run(xy, value * step**2))
        bare.append(run(xy, value))
    np.testing.assert_allclose(found[0], found[1], rtol=0.1, atol=1e-12)
    np.testing.assert_allclose(found[0][:2], found[1][:2], rtol=5e-3)
    np.testing.assert_allclose(bare[0][0], 4 * bare[1][0], rtol=5e-3)


def test_order_padding_and_batches_change_nothing():
    xy, weight = cloud(2)
    base = run(xy, weight)
    order = np.random.default_rng(0).permutation(P)
    np.testing.assert_allclose(run(xy[order], weight[order]), base, rtol=1e-11)
    padded = np.concatenate([xy, np.full((3, 2), np.nan)]), np.append(weight, [0.0, 1.0, np.nan])
    np.testing.assert_allclose(run(*padded), base, rtol=1e-11)
    batch = [np.stack(rows) for rows in zip(*(cloud(seed) for seed in range(4)), strict=True)]
    for one, *points in zip(jax.jit(jax.vmap(moments.hu))(*batch), *batch, strict=True):
        np.testing.assert_allclose(one, run(*points), rtol=1e-11)


def test_one_trace_for_all_values():
    counted = jax.jit(chex.assert_max_traces(moments.hu, n=1))
    for seed in range(3):
        counted(*cloud(seed))


def test_gradients_are_right():
    xy, weight = cloud(3)
    scale = np.asarray(run(xy, weight))
    loss = lambda xy, weight: jnp.sin(moments.hu(xy, weight) / scale).sum()
    assert_gradients_agree(loss, xy, weight, step=1e-6, rtol=1e-5, atol=1e-7)


@jax.jit
def gradient(xy, weight):
    return jax.value_and_grad(lambda *points: moments.hu(*points).sum(), (0, 1))(xy, weight)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_nothing_is_nan_whatever_the_points(kind, dtype):
    xy, weight = (x.astype(dtype) for x in cloud(4, kind))
    found = gradient(xy, weight)
    assert all(leaf.dtype == dtype for leaf in jax.tree.leaves(found))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))
    absent = ~(np.isfinite(xy).all(-1) & (weight > 0))
    assert not found[1][0][absent].any()
    assert not found[1][1][absent].any()


def test_single_precision():
    xy, weight = cloud(5)
    got = run(xy.astype(np.float32), weight.astype(np.float32))
    np.testing.assert_allclose(got, run(xy, weight), rtol=1e-4)
    assert not moments.hu(jnp.zeros((0, 2)), jnp.zeros(0)).any()


def test_what_single_precision_cannot_hold_stays_finite():
    xy, weight = cloud(5)
    found = gradient((1e4 * xy).astype(np.float32), (1e-3 * weight).astype(np.float32))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))


def test_errors_name_the_argument():
    with pytest.raises(ValueError, match=r"weight: got shape \[2\], want \[3\]"):
        moments.hu(np.zeros((3, 2)), np.ones(2))
    with pytest.raises(TypeError, match="xy: got dtype complex128"):
        moments.hu(np.zeros((3, 2), complex), np.ones(3))
    with pytest.raises(ValueError, match=r"image: got shape \[3\]"):
        moments.hu_image(np.zeros(3))


def test_forward_gradients_are_finite_without_points():
    slope = jax.jit(jax.jacfwd(lambda xy: moments.hu(xy, jnp.zeros(4))))(jnp.ones((4, 2)))
    assert jnp.isfinite(slope).all()
