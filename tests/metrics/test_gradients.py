"""What every score of tracks and filters promises: slopes, finite ones, and single precision.

Jitted gradients equal central differences; they are finite whatever the masks say and stands behind
them; float32 in is float32 out.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.metrics import (
    consistency,
    cramer_rao,
    measurement_information,
    nees,
    ospa2,
    ospa2_over_time,
    ospa_over_time,
    trajectory_gospa,
)
from jaxtrack.models import range_bearing, transition_matrix, white_noise_acceleration
from jaxtrack.types import Pose, Tracks, Truth
from tests.metrics.differences import assert_gradients_agree

LOOKS, ESTIMATES, TRUTHS = 3, 2, 3


def over_time(x, xm, y, ym, cutoff, order):
    number = jnp.zeros(xm.shape, jnp.int32)
    time_s, none = jnp.zeros(LOOKS, x.dtype), jnp.zeros(xm.shape, x.dtype)
    tracks = Tracks(time_s, x, jnp.zeros((*x.shape, 4), x.dtype), xm, number, number, none, none)
    return ospa_over_time(
        tracks, Truth(time_s, y, ym), cutoff_m=cutoff, cutoff_m_s=cutoff / 2, order=order
    )


def curve(*sets_and_numbers):
    *sets, cutoff, order = sets_and_numbers
    return ospa2_over_time(*sets, cutoff=cutoff, order=order, window=2)


# name: score(estimates, mask, truths, mask, cutoff, order)
TRACKS = {
    "ospa_over_time": over_time,
    "ospa2": lambda *a: ospa2(*a[:4], cutoff=a[4], order=a[5]),
    "ospa2_over_time": curve,
    "trajectory_gospa": lambda *a: trajectory_gospa(
        *a[:4], cutoff=a[4], order=a[5], switch_cost=a[4] / 4
    ),
}
every_score = pytest.mark.parametrize("name", TRACKS)


def total(name, *arguments):
    """Return all parts of a score in one number, each with a weight of its own."""
    leaves = jax.tree.leaves(TRACKS[name](*arguments))
    return sum((1.0 - 0.13 * n) * leaf.sum() for n, leaf in enumerate(leaves))


@functools.cache
def slopes(name):
    return jax.jit(jax.value_and_grad(functools.partial(total, name), argnums=(0, 2, 4, 5)))


def two_sets(seed=4):
    """Return states near each other, no two of them at the same place, and masks.

    The estimates change targets at the last look.
    """
    rng = np.random.default_rng(seed)
    y = rng.normal(scale=4.0, size=(LOOKS, TRUTHS, 4))
    x = y[:, :ESTIMATES] + rng.normal(scale=1.0, size=(LOOKS, ESTIMATES, 4))
    x[-1] = x[-1, ::-1].copy()
    xm, ym = np.ones((LOOKS, ESTIMATES), bool), np.ones((LOOKS, TRUTHS), bool)
    xm[0, 1] = ym[1, 0] = False
    return x, xm, y, ym


@every_score
def test_jitted_gradients_of_scores_equal_differences(name):
    x, xm, y, ym = two_sets()

    def loss(x, y, cutoff, order):
        y = jnp.where(ym[..., None], y, jnp.nan)
        return total(name, x, xm, y, ym, cutoff, order)

    gradients = assert_gradients_agree(loss, x, y, 7.0, 1.5)
    assert all(np.abs(gradient).max() > 1e-3 for gradient in gradients)


def test_some_estimate_switches():
    x, xm, y, ym = two_sets()
    score = jax.jit(TRACKS["trajectory_gospa"])(x, xm, y, ym, 7.0, 1.5)
    assert min(score) > 0.0


@every_score
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_scores_and_slopes_are_finite_and_of_one_precision_whatever_the_masks(name, dtype):
    x, _, y, _ = two_sets()
    y[:, 1] = y[:, 2] = x[:, 1]  # coincident
    full, none = (lambda a: np.ones(a.shape[:2], bool)), (lambda a: np.zeros(a.shape[:2], bool))
    for left in (full, none):
        for right in (full, none):
            hide = lambda a, mask: np.where(mask(a)[..., None], a, np.nan).astype(dtype)
            sets = hide(x, left), left(x), hide(y, right), right(y)
            numbers = jnp.asarray(7.0, dtype), jnp.asarray(2.0, dtype)
            for leaf in jax.tree.leaves(slopes(name)(*sets, *numbers)):
                assert leaf.dtype == dtype
                assert np.isfinite(leaf).all()


def bound(states, mask, sigma, p_detect, covariance, acceleration):
    """Return the trace of the bound after some looks of range and bearing."""
    dtype = states.dtype
    pose = Pose(jnp.asarray([5.0, -3.0], dtype), jnp.asarray(0.3, dtype))
    noise = sigma**2 * jnp.diag(jnp.asarray([1.0, 1e-2], dtype))
    information = measurement_information(
        states, mask, lambda state: range_bearing(state, pose), noise, p_detect
    )
    step = jnp.asarray(1.0, dtype)
    motion = transition_matrix(step), white_noise_acceleration(step, acceleration), information
    found = cramer_rao((covariance + covariance.T) / 2, *(jnp.stack([m] * LOOKS) for m in motion))
    return jnp.trace(found.covariance[-1])


def test_jitted_gradients_of_the_bound_equal_differences():
    rng = np.random.default_rng(2)
    states = rng.normal(size=(4, 4)) * 2.0 + np.array([9.0, 4.0, 0.0, 0.0])
    mask = np.array([True, False, True, True])
    hide = lambda x: jnp.where(mask[:, None], x, jnp.nan)
    loss = lambda x, *rest: bound(hide(x), mask, *rest)
    root = np.eye(4) + 0.2 * rng.normal(size=(4, 4))
    assert_gradients_agree(loss, states, 0.8, 0.7, root @ root.T, 0.5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_bound_is_finite_and_of_one_precision_whatever_the_mask(dtype):
    slope = jax.jit(jax.value_and_grad(bound, argnums=(0, 2, 3, 4, 5)))
    number = lambda x: jnp.asarray(x, dtype)
    states = np.array([[9.0, 4.0, 0.0, 0.0], [5.0, 4.0, 0.0, 0.0]], dtype)
    for mask, p_detect in (((True, True), 1.0), ((False, False), 0.7), ((True, True), 0.0)):
        there = np.where(np.array(mask)[:, None], states, np.nan).astype(dtype)
        numbers = number(0.8), number(p_detect), jnp.eye(4, dtype=dtype), number(0.5)
        for leaf in jax.tree.leaves(slope(there, np.array(mask), *numbers)):
            assert leaf.dtype == dtype
            assert np.isfinite(leaf).all()


def error(mean, covariance, truth):
    return nees(mean, (covariance + covariance.T) / 2, truth).squared


def test_jitted_gradients_of_nees_equal_differences():
    rng = np.random.default_rng(3)
    root = np.eye(4) + 0.2 * rng.normal(size=(4, 4))
    mean, truth = rng.normal(size=(2, 4))
    assert_gradients_agree(error, mean, root @ root.T, truth)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_nees_and_its_mean_are_finite_and_of_one_precision(dtype):
    slope = jax.jit(jax.value_and_grad(error, argnums=(0, 1, 2)))
    one, zero = np.ones(4, dtype), np.zeros(4, dtype)
    for mean, covariance in ((one, np.eye(4)), (zero, np.eye(4)), (one, np.zeros((4, 4)))):
        for leaf in jax.tree.leaves(slope(mean, covariance.astype(dtype), zero)):
            assert leaf.dtype == dtype
            assert np.isfinite(leaf).all()
    squared = np.full((3, 2), 4.0, dtype)

    def average(squared, mask):
        return consistency(jnp.where(mask, squared, jnp.nan), mask, freedom=4).mean.sum()

    run = jax.jit(jax.value_and_grad(average))
    for mask, expected in ((np.ones((3, 2), bool), 8.0), (np.zeros((3, 2), bool), 0.0)):
        value, gradient = run(squared, mask)
        assert value == expected
        assert value.dtype == gradient.dtype == dtype
        assert np.isfinite(gradient).all()
