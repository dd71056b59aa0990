"""The smoother against one big conditioning, the textbook and two other libraries."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.filtering.gaussian import Moments, predict
from jaxtrack.filtering.kalman import KalmanParams, kalman
from jaxtrack.filtering.smoother import smooth
from tests.filtering.looks import (
    SIZE,
    assert_moments,
    assert_near,
    assert_rows_are_alone,
    assert_sound,
    bare_looks,
    batched,
    long_looks,
    position_looks,
    prior,
    single,
)
from tests.filtering.peers import dynamax_smoother
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import kalman as oracle

SIGMA_A = 0.7
PARAMS = KalmanParams(prior(), SIGMA_A, 3.0)


def smoothed(params, scans):
    estimator = kalman(params)
    info = jax.lax.scan(estimator.step, estimator.init(jax.random.key(0)), scans)[1]
    return smooth(info.filtered, info.predicted, info.transition, info.noise), info


run_all = jax.jit(jax.vmap(smoothed, (None, 0)))


def run(params, scans):
    return batched(run_all, params, scans)


@pytest.mark.parametrize("seed", range(5))
def test_equals_one_big_conditioning(seed):
    seen = np.random.default_rng(seed).random(SIZE) < 0.7
    scans, looks = position_looks(seed, seen)
    looks = [look | {"delay": 0.0} for look in looks]
    scans = scans._replace(delay_s=np.zeros((SIZE, 1)))
    got, _ = run(PARAMS, scans)
    means, covariances = oracle.batch(prior(), looks, SIGMA_A)
    assert_moments(got, list(zip(means, covariances, strict=True)))


def test_equals_the_textbook_where_looks_are_none():
    valid = np.array([False, True, True, False, True, False, True, False])
    scans, looks = position_looks(1, valid=valid)
    done = oracle.run(prior(), looks, oracle.linear_move(SIGMA_A), oracle.observe_position)
    got, info = run(PARAMS, scans)
    assert_moments(got, oracle.smooth(done))
    for after, before in zip(got, info.filtered, strict=True):
        np.testing.assert_array_equal(after[-1], before[-1])
        np.testing.assert_allclose(after[3], after[2], rtol=1e-9, atol=1e-9)


def test_filterpy_agrees():
    peer = pytest.importorskip("filterpy.kalman")
    scans, _ = position_looks(2)
    got, info = run(PARAMS, scans)
    filtered = jax.tree.map(np.asarray, info.filtered)
    other = peer.KalmanFilter(dim_x=4, dim_z=2)
    means, covariances, _, _ = other.rts_smoother(
        filtered.mean, filtered.covariance, np.asarray(info.transition), np.asarray(info.noise)
    )
    assert_moments(got, list(zip(means, covariances, strict=True)))


def test_dynamax_agrees():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        peer = pytest.importorskip("dynamax.linear_gaussian_ssm.inference")
    scans, looks = position_looks(3)
    got, _ = run(PARAMS, scans)
    other = dynamax_smoother(peer, prior(), looks, SIGMA_A)
    pairs = zip(
        np.asarray(other.smoothed_means), np.asarray(other.smoothed_covariances), strict=True
    )
    # It adds 1e-9 to the diagonal of every matrix that it solves with.
    assert_moments(got, list(pairs), rtol=3e-8)


def test_gradients_agree_with_central_differences():
    # Two states say as much as four, and compile much faster.
    rng = np.random.default_rng(4)
    shapes = ((4, 2), (4, 2, 3), (4, 2, 2), (4, 2, 3))
    means, roots, transitions, noise_roots = (rng.normal(size=shape) for shape in shapes)
    square = jax.vmap(lambda a: a @ a.T)

    def loss(means, roots, transitions, noise_roots):
        filtered, noises = Moments(means, square(roots)), square(noise_roots)
        before = jax.vmap(predict)(*filtered, transitions, noises)
        # Rolled, for a look is predicted from the one before it.
        ahead = Moments(*(jnp.roll(x, 1, 0) for x in before))
        turned, added = jnp.roll(transitions, 1, 0), jnp.roll(noises, 1, 0)
        after = smooth(filtered, ahead, turned, added)
        return (after.mean**2).sum() + after.covariance.sum()

    arguments = (means, roots, transitions, noise_roots)
    gradients = assert_gradients_agree(loss, *arguments, atol=1e-8)
    assert all(np.abs(g).max() > 1e-3 for g in gradients)


@pytest.mark.slow  # compiles for long where nothing is cached
def test_ten_thousand_steps_in_float32():
    wide, scans = long_looks()
    params = KalmanParams(wide, 0.05, 3.0)
    got, _ = jax.jit(smoothed)(*single((params, scans)))
    assert got.mean.dtype == got.covariance.dtype == np.float32
    assert_sound(got.covariance)
    move = oracle.linear_move(0.05)
    done = oracle.run(wide, bare_looks(scans), move, oracle.observe_position)
    assert_near(got, oracle.smooth(done))


@pytest.mark.slow  # compiles for long where nothing is cached
def test_a_batch_is_its_realizations():
    several = [position_looks(seed)[0] for seed in range(3)]
    assert_rows_are_alone(run_all, several, PARAMS)


def test_shapes_that_do_not_fit_are_refused():
    whole = Moments(np.zeros((3, 2)), np.zeros((3, 2, 2)))  # pyright: ignore
    short = Moments(np.zeros((2, 2)), np.zeros((2, 2, 2)))  # pyright: ignore
    matrices = np.zeros((3, 2, 2))
    with pytest.raises(ValueError, match=r"predicted.mean: got shape \[2, 2\], want \[3, 2\]"):
        smooth(whole, short, matrices, matrices)  # pyright: ignore
    with pytest.raises(ValueError, match="noises"):
        smooth(whole, whole, matrices, matrices[1:])  # pyright: ignore
