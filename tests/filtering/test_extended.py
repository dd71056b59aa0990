"""The extended Kalman filter against the textbook's equations and FilterPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.filtering.extended import extended, linearize, predict, update
from jaxtrack.filtering.polar import PolarParams
from jaxtrack.filtering.smoother import smooth
from jaxtrack.models import constant_velocity, coordinated_turn
from tests.filtering.looks import (
    LONG,
    SIZE,
    assert_moments,
    assert_near,
    assert_rows_are_alone,
    assert_sound,
    batched,
    long_polar_looks,
    polar_looks,
    prior,
    single,
)
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import kalman as oracle

pytestmark = pytest.mark.slow  # compiles for a minute where nothing is cached

few = settings(max_examples=12, deadline=None, derandomize=True, database=None)
flags = st.lists(st.booleans(), min_size=SIZE, max_size=SIZE)
SIGMA_A, SIGMA_TURN = 0.5, 0.02
PARAMS = PolarParams(prior(5), 2.0, 0.03)


def filtered(params, scans, sigma_a=SIGMA_A, sigma_turn=SIGMA_TURN):
    estimator = extended(params, coordinated_turn(sigma_a, sigma_turn))
    return jax.lax.scan(estimator.step, estimator.init(jax.random.key(0)), scans)


def smoothed(params, scans):
    info = filtered(params, scans)[1]
    return info, smooth(info.filtered, info.predicted, info.transition, info.noise)


run_all = jax.jit(jax.vmap(smoothed, (None, 0)))


def run(params, scans):
    return batched(run_all, params, scans)


def expected(looks):
    move = oracle.turn_move(SIGMA_A, SIGMA_TURN)
    return oracle.run(prior(5), looks, move, oracle.observe_polar)


@few
@given(st.integers(0, 2**32 - 1), flags, flags)
def test_equals_the_textbook(seed, seen, valid):
    scans, looks = polar_looks(seed, seen, valid)
    info, after = run(PARAMS, scans)
    done = expected(looks)
    assert_moments(info.predicted, [one["predicted"] for one in done])
    assert_moments(info.filtered, [one["filtered"] for one in done])
    assert_moments(after, oracle.smooth(done), rtol=1e-8)
    log_likelihood = [one["log_likelihood"] for one in done]
    np.testing.assert_allclose(info.log_likelihood, log_likelihood, rtol=1e-9, atol=1e-9)


def test_the_scene_passes_behind_the_sensor():
    bearings = np.concatenate([polar_looks(seed)[0].bearing_rad.ravel() for seed in range(3)])
    assert np.abs(np.diff(bearings)).max() > np.pi


def test_what_is_masked_changes_nothing():
    seen, valid = np.ones((2, SIZE), bool)
    seen[[1, 4]], valid[[2, 6]] = False, False
    scans, _ = polar_looks(3, seen, valid)
    fill = lambda x: np.where(np.isnan(x), 7e5, x) if x.dtype == float else x
    got, again = run(PARAMS, scans), run(PARAMS, jax.tree.map(fill, scans))
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
        assert np.isfinite(b).all()


def test_a_batch_is_its_realizations():
    several = [polar_looks(seed)[0] for seed in range(3)]
    assert_rows_are_alone(run_all, several, PARAMS)


def test_gradients_agree_with_central_differences():
    seen, valid = np.ones((2, SIZE), bool)
    seen[[1, 4]], valid[6] = False, False
    scans, _ = polar_looks(4, seen, valid)
    there = (seen & valid)[:, None]
    start = prior()

    def loss(mean, sigmas, ranges, bearings):
        params = PolarParams(
            start._replace(mean=10 * mean), 2 * sigmas[0], sigmas[1] / 30, sigmas[2:4]
        )
        polar = scans._replace(
            range_m=jnp.where(there, 10 * ranges, jnp.nan),
            bearing_rad=jnp.where(there, bearings, jnp.nan),
            covariance=None,
        )
        # The turn's own derivatives are held in `tests/models/test_process.py`.
        estimator = extended(params, constant_velocity(sigmas[4]))
        first = estimator.init(jax.random.key(0))
        return jax.lax.scan(estimator.step, first, polar)[1].log_likelihood.sum() / 10

    arguments = (
        start.mean / 10,
        np.array([1.1, 0.9, 0.7, -0.5, 0.5]),
        np.nan_to_num(scans.range_m) / 10,
        np.nan_to_num(scans.bearing_rad),
    )
    gradients = assert_gradients_agree(loss, *arguments, step=3e-6, atol=1e-7)
    assert all(np.abs(g).max() > 1e-3 for g in gradients)
    np.testing.assert_array_equal(gradients[2][~there], 0.0)


def test_filterpy_agrees():
    peer = pytest.importorskip("filterpy.kalman")

    class Turning(peer.ExtendedKalmanFilter):
        def predict_x(self, u=0):
            self.x = oracle.turned(self.x, self.dt)

    scans, looks = polar_looks(5, [True] * 5 + [False, True, True])
    info, _ = run(PARAMS, scans)
    other = Turning(dim_x=5, dim_z=2)
    other.x, other.P = prior(5).mean, prior(5).covariance
    time = prior().time_s
    for k, look in enumerate(looks):
        other.dt, time = look["time"] - time, look["time"]
        other.F = oracle.jacobian(lambda x, dt=other.dt: oracle.turned(x, dt), other.x)
        other.Q = oracle.turn_noise(other.dt, SIGMA_A, SIGMA_TURN)
        other.predict()
        if look["seen"]:
            other.update(
                look["z"],
                lambda x, look=look: oracle.range_bearing_jacobian(x, look["position"]),
                lambda x, look=look: oracle.range_bearing(x, look["position"], look["heading"]),
                R=look["R"],
                residual=lambda a, b: np.array([a[0] - b[0], oracle.wrapped(a[1] - b[1])]),
            )
            np.testing.assert_allclose(info.log_likelihood[k], other.log_likelihood, rtol=1e-9)
        one = jax.tree.map(lambda x, k=k: x[k : k + 1], info.filtered)
        assert_moments(one, [(other.x, other.P)])


def test_single_steps_are_the_linear_ones_of_the_tangent():
    rng = np.random.default_rng(6)
    mean, matrix, z = rng.normal(size=3), rng.normal(size=(2, 3)), rng.normal(size=2)
    p, q, r = (a @ a.T for a in (rng.normal(size=s) for s in ((3, 4), (3, 4), (2, 3))))
    move, measure = lambda x: x + 0.1 * jnp.sin(x), lambda x: jnp.tanh(matrix @ x)
    moved, after, linear = jax.jit(
        lambda mean, p: (
            predict(mean, p, move, q),
            update(mean, p, z, measure, r),
            linearize(measure, mean, p),
        )
    )(mean, p)
    f = np.diag(1 + 0.1 * np.cos(mean))
    np.testing.assert_allclose(moved.covariance, f @ p @ f.T + q, rtol=1e-12)
    h = (1 - np.tanh(matrix @ mean) ** 2)[:, None] * matrix
    m, c, _ = oracle.update(mean, p, z - np.tanh(matrix @ mean), h, r)
    np.testing.assert_allclose(after.mean, m, rtol=1e-10)
    np.testing.assert_allclose(after.covariance, c, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(linear.matrix, h, rtol=1e-12)
    np.testing.assert_array_equal(linear.excess, 0.0)


def test_ten_thousand_steps_in_float32():
    start, scans, states = long_polar_looks()
    params = PolarParams(start, 5.0, 0.01)

    @jax.jit
    def run(params, scans, sigma_a, sigma_turn):
        return filtered(params, scans, sigma_a, sigma_turn)[1].filtered

    got = run(*single((params, scans, 0.1, 1e-3)))
    assert got.mean.dtype == got.covariance.dtype == np.float32
    assert_sound(got.covariance)
    # Its own sigmas count here, for these looks carry no covariances.
    looks = [
        {
            "time": time,
            "valid": True,
            "seen": seen[0],
            "z": np.array([r[0], b[0]]),
            "R": np.diag([25.0, 1e-4]),
            "position": np.zeros(2),
            "heading": 0.0,
        }
        for time, _, r, b, seen, *_ in zip(*scans[:5], strict=True)
    ][:300]
    done = oracle.run(start, looks, oracle.turn_move(0.1, 1e-3), oracle.observe_polar)
    assert_near((x[:300] for x in got), [one["filtered"] for one in done])
    error = np.asarray(got.mean) - states
    assert np.sqrt((error[100:, :2] ** 2).sum(-1)).max() < 100.0
    assert np.abs(error[100:, 4]).max() < 0.02
    assert len(error) == LONG


def test_one_look_has_one_detection():
    estimator = extended(PARAMS, coordinated_turn(1.0, 1.0))
    wide = jax.tree.map(lambda x: x[0], polar_looks(0)[0])._replace(range_m=jnp.ones(3))
    key = jax.random.key(0)
    with pytest.raises(ValueError, match=r"scan.range_m: got shape \[3\], want \[1\]"):
        jax.eval_shape(lambda: estimator.step(estimator.init(key), wide))
