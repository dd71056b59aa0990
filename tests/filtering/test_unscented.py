"""The unscented Kalman filter against the textbook's weighted sums and FilterPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.filtering.polar import PolarParams
from jaxtrack.filtering.smoother import smooth
from jaxtrack.filtering.unscented import Spread, linearize, predict, unscented, update
from jaxtrack.models import Motion, coordinated_turn
from tests.filtering.looks import (
    SIZE,
    assert_moments,
    assert_rows_are_alone,
    assert_sound,
    batched,
    long_polar_looks,
    polar_looks,
    prior,
    single,
)
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import kalman as textbook
from tests.oracles import unscented as oracle

pytestmark = pytest.mark.slow  # compiles for a minute where nothing is cached

few = settings(max_examples=12, deadline=None, derandomize=True, database=None)
flags = st.lists(st.booleans(), min_size=SIZE, max_size=SIZE)
SIGMA_A, SIGMA_TURN = 0.5, 0.02
PARAMS = PolarParams(prior(5), 2.0, 0.03)
SPREADS = [(1.0, 2.0, 0.0), (0.7, 2.0, -1.0), (0.1, 2.0, 1.0)]
turn_noise = lambda dt: textbook.turn_noise(dt, SIGMA_A, SIGMA_TURN)


def filtered(params, scans, spread=None, sigma_a=SIGMA_A, sigma_turn=SIGMA_TURN):
    estimator = unscented(params, coordinated_turn(sigma_a, sigma_turn), spread)
    return jax.lax.scan(estimator.step, estimator.init(jax.random.key(0)), scans)


def smoothed(params, scans, spread):
    info = filtered(params, scans, spread)[1]
    return info, smooth(info.filtered, info.predicted, info.transition, info.noise)


run_all = jax.jit(jax.vmap(smoothed, (None, 0, None)))


def run(params, scans, spread):
    return batched(run_all, params, scans, spread)


def expected(looks, spread):
    move = oracle.mover(textbook.turned, turn_noise, spread)
    return textbook.run(prior(5), looks, move, oracle.polar_observer(spread))


@few
@given(st.integers(0, 2**32 - 1), flags, flags, st.sampled_from(SPREADS))
def test_equals_the_textbook(seed, seen, valid, spread):
    scans, looks = polar_looks(seed, seen, valid)
    info, after = run(PARAMS, scans, Spread(*spread))
    done = expected(looks, spread)
    rtol = 1e-9 / spread[0] ** 2
    assert_moments(info.predicted, [one["predicted"] for one in done], rtol)
    assert_moments(info.filtered, [one["filtered"] for one in done], rtol)
    log_likelihood = [one["log_likelihood"] for one in done]
    np.testing.assert_allclose(info.log_likelihood, log_likelihood, rtol=rtol, atol=rtol)
    if all(valid):
        times = [prior().time_s, *[look["time"] for look in looks]]
        past = oracle.smooth(done, textbook.turned, np.diff(times), spread)
        assert_moments(after, past, 10 * rtol)


def test_its_smoother_is_the_unscented_one():
    scans, looks = polar_looks(1)
    _, after = run(PARAMS, scans, Spread())
    dts = np.diff([prior().time_s, *[look["time"] for look in looks]])
    done = expected(looks, SPREADS[0])
    assert_moments(after, oracle.smooth(done, textbook.turned, dts, SPREADS[0]))


def test_what_is_masked_changes_nothing():
    seen, valid = np.ones((2, SIZE), bool)
    seen[[1, 4]], valid[[2, 6]] = False, False
    scans, _ = polar_looks(3, seen, valid)
    fill = lambda x: np.where(np.isnan(x), 7e5, x) if x.dtype == float else x
    got, again = (run(PARAMS, x, Spread()) for x in (scans, jax.tree.map(fill, scans)))
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
        assert np.isfinite(b).all()


def test_a_batch_is_its_realizations():
    several = [polar_looks(seed)[0] for seed in range(3)]
    assert_rows_are_alone(run_all, several, PARAMS, Spread())


def test_gradients_agree_with_central_differences():
    seen = np.ones(SIZE, bool)
    seen[[1, 4]] = False
    scans, _ = polar_looks(4, seen)
    start = prior(2)

    def loss(mean, sigmas, bearings):
        # Two states go through the same lines as five, and compile much faster.
        wander = lambda x, dt: x + dt * 10 * jnp.sin(x / 10)
        motion = Motion(wander, lambda dt: sigmas[5] * dt * jnp.eye(2))
        params = PolarParams(start._replace(mean=10 * mean), 2 * sigmas[0], sigmas[1] / 30)
        bearings = jnp.where(seen[:, None], bearings, jnp.nan)
        polar = scans._replace(bearing_rad=bearings, covariance=None)
        estimator = unscented(params, motion, Spread(sigmas[2], 2 * sigmas[3], sigmas[4]))
        first = estimator.init(jax.random.key(0))
        return jax.lax.scan(estimator.step, first, polar)[1].log_likelihood.sum() / 100

    arguments = (
        start.mean / 10,
        np.array([1.1, 0.9, 1.0, 1.0, 0.3, 0.5]),
        np.nan_to_num(scans.bearing_rad),
    )
    gradients = assert_gradients_agree(loss, *arguments, step=3e-6, atol=1e-7)
    assert all(np.isfinite(g).all() and np.abs(g).max() > 1e-3 for g in gradients)
    np.testing.assert_array_equal(gradients[2][~seen], 0.0)


def test_filterpy_agrees():
    peer = pytest.importorskip("filterpy.kalman")
    scans, looks = polar_looks(5, [True] * 5 + [False, True, True])
    alpha, beta, kappa = SPREADS[1]
    info = run(PARAMS, scans, Spread(alpha, beta, kappa))[0]
    points = peer.MerweScaledSigmaPoints(5, alpha, beta, kappa)

    def mean_of(sigmas, weights):
        apart = np.array([oracle.polar_subtract(s, sigmas[0]) for s in sigmas])
        return sigmas[0] + weights @ apart

    other = peer.UnscentedKalmanFilter(
        5,
        2,
        1.0,
        hx=lambda x, look: textbook.range_bearing(x, look["position"], look["heading"]),
        fx=textbook.turned,
        points=points,
        z_mean_fn=mean_of,
        residual_z=oracle.polar_subtract,
    )
    other.x, other.P = prior(5).mean, prior(5).covariance
    time = prior().time_s
    for k, look in enumerate(looks):
        dt, time = look["time"] - time, look["time"]
        other.Q = turn_noise(dt)
        other.predict(dt=dt)
        if look["seen"]:
            other.update(look["z"], R=look["R"], look=look)
            np.testing.assert_allclose(info.log_likelihood[k], other.log_likelihood, rtol=1e-9)
        one = jax.tree.map(lambda x, k=k: x[k : k + 1], info.filtered)
        assert_moments(one, [(other.x, other.P)])


def test_single_steps_equal_the_weighted_sums():
    rng = np.random.default_rng(6)
    mean, matrix, z = rng.normal(size=3), rng.normal(size=(2, 3)), rng.normal(size=2)
    p, q, r = (a @ a.T for a in (rng.normal(size=s) for s in ((3, 4), (3, 4), (2, 3))))
    spread = (0.8, 1.5, 0.5)
    moved, after = jax.jit(
        lambda mean, p: (
            predict(mean, p, lambda x: x + jnp.sin(x), q, Spread(*spread)),
            update(mean, p, z, lambda x: jnp.tanh(matrix @ x), r, spread=Spread(*spread)),
        )
    )(mean, p)
    m, c = oracle.predict(mean, p, lambda x: x + np.sin(x), q, spread)
    np.testing.assert_allclose(moved.mean, m, rtol=1e-12)
    np.testing.assert_allclose(moved.covariance, c, rtol=1e-11, atol=1e-13)
    m, c, log_likelihood = oracle.update(
        mean, p, z, lambda x: np.tanh(matrix @ x), r, oracle.subtract, spread
    )
    np.testing.assert_allclose(after.mean, m, rtol=1e-10)
    np.testing.assert_allclose(after.covariance, c, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(after.log_likelihood, log_likelihood, rtol=1e-10)


def test_a_linear_function_is_itself():
    rng = np.random.default_rng(7)
    mean, matrix, root = rng.normal(size=4), rng.normal(size=(2, 4)), rng.normal(size=(4, 5))
    linear = jax.jit(lambda mean, p: linearize(lambda x: matrix @ x, mean, p))(mean, root @ root.T)
    np.testing.assert_allclose(linear.value, matrix @ mean, rtol=1e-12)
    np.testing.assert_allclose(linear.matrix, matrix, rtol=1e-10)
    np.testing.assert_allclose(linear.excess, 0.0, atol=1e-24)


def test_ten_thousand_steps_in_float32():
    start, scans, states = long_polar_looks()
    params = PolarParams(start, 5.0, 0.01)

    @jax.jit
    def run(params, scans, sigma_a, sigma_turn):
        return filtered(params, scans, None, sigma_a, sigma_turn)[1].filtered

    got = run(*single((params, scans, 0.1, 1e-3)))
    assert got.mean.dtype == got.covariance.dtype == np.float32
    assert_sound(got.covariance)
    error = np.asarray(got.mean) - states
    assert np.sqrt((error[100:, :2] ** 2).sum(-1)).max() < 100.0
    assert np.abs(error[100:, 4]).max() < 0.02
