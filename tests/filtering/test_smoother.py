"""The smoother against one big conditioning, the textbook and two other libraries."""

import warnings

import jax
import numpy as np
import pytest

from jaxtrack.filtering.gaussian import Moments
from jaxtrack.filtering.kalman import KalmanParams, kalman
from jaxtrack.filtering.smoother import smooth
from tests.filtering.looks import (
    SIZE,
    assert_moments,
    assert_sound,
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


run = jax.jit(smoothed)


@pytest.mark.parametrize("seed", range(5))
def test_equals_one_big_conditioning(seed):
    seen = np.random.default_rng(seed).random(SIZE) < 0.7
    scans, looks = position_looks(seed, seen, own=seed > 0)
    looks = [look | {"delay": 0.0} for look in looks]
    scans = scans._replace(delay_s=None if seed == 0 else np.zeros((SIZE, 1)))
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
    scans, looks = position_looks(2)
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
    seen = np.ones(SIZE, bool)
    seen[[1, 4]] = False
    scans, _ = position_looks(4, seen)
    start = prior()

    def loss(mean, sigmas):
        params = KalmanParams(start._replace(mean=10 * mean), sigmas[0], 3 * sigmas[1])
        after, _ = smoothed(params, scans._replace(covariance_m2=None))
        return (after.mean**2).sum() / 1e4 + after.covariance.sum() / 1e2

    assert_gradients_agree(loss, start.mean / 10, np.array([0.7, 1.1]), atol=1e-8)


def test_ten_thousand_steps_in_float32():
    wide, scans = long_looks()
    params = KalmanParams(wide, 0.05, 3.0)
    got, _ = run(single(params), single(scans))
    assert got.mean.dtype == got.covariance.dtype == np.float32
    assert_sound(got.covariance)
    double, _ = run(params, scans)
    sigma = np.sqrt(np.diagonal(double.covariance, axis1=1, axis2=2))
    assert (np.abs(np.asarray(got.mean) - np.asarray(double.mean)) / sigma)[10:].max() < 0.05
    variance = np.diagonal(got.covariance, axis1=1, axis2=2)
    np.testing.assert_allclose(variance[10:], sigma[10:] ** 2, rtol=0.01)


def test_vmap_is_a_loop():
    several = [position_looks(seed)[0] for seed in range(3)]
    stacked = jax.tree.map(lambda *x: np.stack(x), *several)
    got, _ = jax.jit(jax.vmap(smoothed, (None, 0)))(PARAMS, stacked)
    for n, scans in enumerate(several):
        for a, b in zip(got, run(PARAMS, scans)[0], strict=True):
            np.testing.assert_allclose(a[n], b, rtol=1e-9, atol=1e-9)


def test_shapes_that_do_not_fit_are_refused():
    whole = Moments(np.zeros((3, 2)), np.zeros((3, 2, 2)))  # pyright: ignore
    short = Moments(np.zeros((2, 2)), np.zeros((2, 2, 2)))  # pyright: ignore
    matrices = np.zeros((3, 2, 2))
    with pytest.raises(ValueError, match=r"predicted.mean: got shape \[2, 2\], want \[3, 2\]"):
        smooth(whole, short, matrices, matrices)  # pyright: ignore
    with pytest.raises(ValueError, match="noises"):
        smooth(whole, whole, matrices, matrices[1:])  # pyright: ignore
