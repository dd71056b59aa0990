"""The Kalman filter against the textbook's equations and two other libraries."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.filtering.gaussian import Prior, begin, predict
from jaxtrack.filtering.kalman import KalmanParams, kalman, update
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
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import kalman as oracle

few = settings(max_examples=12, deadline=None, derandomize=True, database=None)
flags = st.lists(st.booleans(), min_size=SIZE, max_size=SIZE)
SIGMA_A, SIGMA_M = 0.7, 3.0
PARAMS = KalmanParams(prior(), SIGMA_A, SIGMA_M)


def filtered(params, scans):
    estimator = kalman(params)
    return jax.lax.scan(estimator.step, estimator.init(jax.random.key(0)), scans)


run_all = jax.jit(jax.vmap(filtered, (None, 0)))


def run(params, scans):
    return batched(run_all, params, scans)


def expected(looks):
    return oracle.run(prior(), looks, oracle.linear_move(SIGMA_A), oracle.observe_position)


def assert_agrees(info, done, rtol=1e-9):
    assert_moments(info.predicted, [one["predicted"] for one in done], rtol)
    assert_moments(info.filtered, [one["filtered"] for one in done], rtol)
    log_likelihood = [one["log_likelihood"] for one in done]
    np.testing.assert_allclose(info.log_likelihood, log_likelihood, rtol=rtol, atol=rtol)


@few
@given(st.integers(0, 2**32 - 1), flags, flags)
def test_equals_the_textbook(seed, seen, valid):
    scans, looks = position_looks(seed, seen, valid)
    state, info = run(PARAMS, scans)
    done = expected(looks)
    assert_agrees(info, done)
    np.testing.assert_array_equal(info.seen, np.array(seen) & np.array(valid))
    np.testing.assert_allclose(info.transition, [one["F"] for one in done], rtol=1e-12)
    np.testing.assert_allclose(info.noise, [one["Q"] for one in done], rtol=1e-12)
    np.testing.assert_array_equal(state.mean, info.filtered.mean[-1])
    times = [look["time"] for look in looks if look["valid"]]
    assert float(state.time_s) == (times[-1] if times else prior().time_s)
    assert np.asarray(info.definite).all()


def test_a_weight_of_zero_is_no_detection():
    seen = [True] * 3 + [False] + [True] * 4
    scans, _ = position_looks(2)
    weight = np.array(scans.weight)
    weight[3] = 0.0
    got = run(PARAMS, scans._replace(weight=weight))[1]
    want = run(PARAMS, position_looks(2, seen)[0])[1]
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_is_masked_changes_nothing():
    seen, valid = np.ones((2, SIZE), bool)
    seen[[1, 4]], valid[[2, 6]] = False, False
    scans, _ = position_looks(3, seen, valid)
    there = seen & valid

    def fill(x):
        return np.where(np.isnan(x), 7e5, x) if x.dtype == float else x

    for a, b in zip(
        jax.tree.leaves(run(PARAMS, scans)),
        jax.tree.leaves(run(PARAMS, jax.tree.map(fill, scans))),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)
        assert np.isfinite(b).all()
    info = run(PARAMS, scans)[1]
    np.testing.assert_array_equal(info.filtered.mean[2], info.filtered.mean[1])
    np.testing.assert_array_equal(info.filtered.covariance[2], info.filtered.covariance[1])
    np.testing.assert_array_equal(info.log_likelihood == 0, ~there)


def test_a_batch_is_its_realizations():
    several = [position_looks(seed)[0] for seed in range(3)]
    assert_rows_are_alone(run_all, several, PARAMS)


def test_gradients_agree_with_central_differences():
    seen, valid = np.ones((2, SIZE), bool)
    seen[[1, 4]], valid[6] = False, False
    scans, _ = position_looks(4, seen, valid)
    start = prior()

    def loss(mean, root, sigmas, position):
        params = KalmanParams(
            Prior(10 * mean, root @ root.T, start.time_s), sigmas[0], 3 * sigmas[1]
        )
        at = jnp.where(scans.mask[:, :, None] & scans.valid[:, None, None], 10 * position, jnp.nan)
        bare = scans._replace(position_m=at, covariance_m2=None)
        return filtered(params, bare)[1].log_likelihood.sum() / 10

    position = np.nan_to_num(scans.position_m) / 10
    root = np.linalg.cholesky(start.covariance)
    arguments = (start.mean / 10, root, np.array([0.7, 1.1]), position)
    gradients = assert_gradients_agree(loss, *arguments, atol=1e-8)
    assert all(np.abs(g).max() > 1e-3 for g in gradients)
    np.testing.assert_array_equal(gradients[3][~(seen & valid)], 0.0)


def test_filterpy_agrees():
    peer = pytest.importorskip("filterpy.kalman")
    scans, looks = position_looks(5, [True] * 5 + [False, True, True])
    info = run(PARAMS, scans)[1]
    other = peer.KalmanFilter(dim_x=4, dim_z=2)
    other.x, other.P = prior().mean, prior().covariance
    time = prior().time_s
    for k, look in enumerate(looks):
        dt, time = look["time"] - time, look["time"]
        other.predict(F=oracle.transition(dt), Q=oracle.acceleration_noise(dt, SIGMA_A))
        np.testing.assert_allclose(info.predicted.covariance[k], other.P, rtol=1e-9, atol=1e-9)
        if look["seen"]:
            h = np.concatenate([np.eye(2), look["delay"] * np.eye(2)], axis=1)
            other.update(look["z"], R=look["R"], H=h)
            np.testing.assert_allclose(info.log_likelihood[k], other.log_likelihood, rtol=1e-9)
            np.testing.assert_allclose(info.innovation[k], other.y, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(info.innovation_covariance[k], other.S, rtol=1e-9)
        np.testing.assert_allclose(info.filtered.mean[k], other.x, rtol=1e-9)
        np.testing.assert_allclose(info.filtered.covariance[k], other.P, rtol=1e-9, atol=1e-9)


def test_single_steps_of_other_sizes():
    rng = np.random.default_rng(6)
    mean, f, h, z = (rng.normal(size=s) for s in (3, (3, 3), (2, 3), 2))
    p, q, r = (a @ a.T for a in (rng.normal(size=s) for s in ((3, 4), (3, 4), (2, 3))))
    moved = jax.jit(predict)(mean, p, f, q)
    np.testing.assert_allclose(moved.mean, f @ mean, rtol=1e-12)
    np.testing.assert_allclose(moved.covariance, f @ p @ f.T + q, rtol=1e-12)
    after = jax.jit(update)(mean, p, z, h, r)
    m, c, log_likelihood = oracle.update(mean, p, z - h @ mean, h, r)
    np.testing.assert_allclose(after.mean, m, rtol=1e-10)
    np.testing.assert_allclose(after.covariance, c, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(after.log_likelihood, log_likelihood, rtol=1e-10)


def test_a_singular_innovation_is_flagged_and_stays_finite():
    zero = jnp.zeros((2, 2))
    after = jax.jit(update)(jnp.zeros(4), jnp.zeros((4, 4)), jnp.ones(2), jnp.eye(2, 4), zero)
    assert not bool(after.definite)
    assert all(np.isfinite(x).all() for x in after)


def test_ten_thousand_steps_in_float32():
    wide, scans = long_looks()
    params = KalmanParams(wide, 0.05, 3.0)
    state, info = jax.jit(filtered)(*single((params, scans)))
    assert {x.dtype for x in jax.tree.leaves((state, info))} == {np.dtype(t) for t in ("f4", "?")}
    assert_sound(info.filtered.covariance)
    assert_sound(info.predicted.covariance)
    done = oracle.run(wide, bare_looks(scans), oracle.linear_move(0.05), oracle.observe_position)
    # Without covariances of their own, the sensor's sigma counts.
    assert_near(info.filtered, [one["filtered"] for one in done])


def test_dynamax_agrees():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        peer = pytest.importorskip("dynamax.linear_gaussian_ssm.inference")
    from tests.filtering.peers import dynamax_smoother

    scans, looks = position_looks(8)
    info = run(PARAMS, scans)[1]
    posterior = dynamax_smoother(peer, prior(), looks, SIGMA_A)
    np.testing.assert_allclose(info.log_likelihood.sum(), posterior.marginal_loglik, rtol=1e-9)
    np.testing.assert_allclose(info.filtered.mean, posterior.filtered_means, rtol=1e-9)
    np.testing.assert_allclose(
        info.filtered.covariance, posterior.filtered_covariances, rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda: begin(Prior(jnp.zeros(4), jnp.eye(3))), "prior.covariance"),
        (lambda: kalman(PARAMS._replace(prior=prior(5))), "params.prior.mean"),
        (lambda: update(*map(jnp.ones, ((4,), (4, 4), (2,), (3, 4), (2, 2)))), "matrix"),
        (lambda: update(*map(jnp.ones, ((4,), (4, 4), (2,), (2, 4), (3, 3)))), "noise"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        change()


def test_two_detections_are_refused():
    scans, _ = position_looks(0, own=False)
    two = jax.tree.map(lambda x: x[0], scans)
    key = jax.random.key(0)
    two = two._replace(position_m=np.zeros((2, 2)), mask=np.ones(2, bool))
    with pytest.raises(ValueError, match=r"scan.position_m: got shape \[2, 2\]"):
        jax.eval_shape(lambda: kalman(PARAMS).step(kalman(PARAMS).init(key), two))
