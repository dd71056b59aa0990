"""The interacting multiple model filter against the textbook's equations and FilterPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.filtering.gaussian import Prior
from jaxtrack.filtering.interacting import (
    InteractingParams,
    combine,
    interacting,
    mix,
    reweigh,
)
from jaxtrack.models import Motion, coordinated_turn, straight
from tests.filtering.looks import (
    LONG,
    SIZE,
    assert_moments,
    assert_rows_are_alone,
    assert_sound,
    batched,
    position_looks,
    prior,
    single,
)
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import interacting as oracle
from tests.oracles import kalman as textbook

pytestmark = pytest.mark.slow  # compiles for a minute where nothing is cached

few = settings(max_examples=12, deadline=None, derandomize=True, database=None)
flags = st.lists(st.booleans(), min_size=SIZE, max_size=SIZE)
SWITCHING = np.array([[0.9, 0.04, 0.06], [0.1, 0.8, 0.1], [0.05, 0.05, 0.9]])
PROBABILITY = np.array([0.5, 0.2, 0.3])
PARAMS = InteractingParams(prior(5), PROBABILITY, SWITCHING, 3.0)  # pyright: ignore
# low and high noise, the turn's own; expected turn rate and its change
SIGMAS = np.array([0.1, 2.0, 0.2, 0.15, 0.03])


def filtered(params, scans, sigmas):
    motions = (
        straight(sigmas[0], sigmas[3]),
        straight(sigmas[1], sigmas[3]),
        coordinated_turn(sigmas[2], sigmas[4]),
    )
    estimator = interacting(params, motions)
    return jax.lax.scan(estimator.step, estimator.init(jax.random.key(0)), scans)


run_all = jax.jit(jax.vmap(filtered, (None, 0, None)))


def run(params, scans, sigmas):
    return batched(run_all, params, scans, sigmas)


def straight_move(sigma_a, sigma_turn):
    """Move without a turn rate: what stands in its place is drawn anew."""

    def move(mean, covariance, dt):
        f, q = np.zeros((5, 5)), np.zeros((5, 5))
        f[:4, :4], q[:4, :4] = textbook.transition(dt), textbook.acceleration_noise(dt, sigma_a)
        q[4, 4] = sigma_turn**2
        return f @ mean, f @ covariance @ f.T + q, f, q

    return move


def expected(looks):
    moves = [
        lambda *x: straight_move(SIGMAS[0], SIGMAS[3])(*x)[:2],
        lambda *x: straight_move(SIGMAS[1], SIGMAS[3])(*x)[:2],
        lambda *x: textbook.turn_move(SIGMAS[2], SIGMAS[4])(*x)[:2],
    ]
    return oracle.run(prior(5), PROBABILITY, SWITCHING, looks, moves, textbook.observe_position)


@few
@given(st.integers(0, 2**32 - 1), flags, flags)
def test_equals_the_textbook(seed, seen, valid):
    scans, looks = position_looks(seed, seen, valid)
    state, info = run(PARAMS, scans, SIGMAS)
    done = expected(looks)
    assert_moments(info.predicted, [one["predicted"] for one in done])
    assert_moments(info.filtered, [one["filtered"] for one in done])
    for name in ("probability", "log_likelihood"):
        want = np.stack([one[name] for one in done])
        np.testing.assert_allclose(getattr(info, name), want, rtol=1e-9, atol=1e-10)
    means = np.stack([one["means"] for one in done])
    np.testing.assert_allclose(info.models.mean, means, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(state.mean, info.models.mean[-1])


def test_what_is_masked_changes_nothing():
    seen, valid = np.ones((2, SIZE), bool)
    seen[[1, 4]], valid[[2, 6]] = False, False
    scans, _ = position_looks(3, seen, valid)
    fill = lambda x: np.where(np.isnan(x), 7e5, x) if x.dtype == float else x
    got, again = (run(PARAMS, x, SIGMAS) for x in (scans, jax.tree.map(fill, scans)))
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
        assert np.isfinite(b).all()
    probability = got[1].probability
    np.testing.assert_array_equal(probability[2], probability[1])
    np.testing.assert_allclose(probability[1], probability[0] @ SWITCHING, rtol=1e-12)


def test_a_batch_is_its_realizations():
    several = [position_looks(seed)[0] for seed in range(3)]
    assert_rows_are_alone(run_all, several, PARAMS, SIGMAS)


def test_gradients_agree_with_central_differences():
    seen, valid = np.ones((2, SIZE), bool)
    seen[[1, 4]], valid[6] = False, False
    scans, _ = position_looks(4, seen, valid)
    there = (seen & valid)[:, None, None]
    start = prior(5)

    def loss(mean, chances, switching, sigmas, position):
        # Without the turn, whose derivatives `tests/models` holds, it compiles faster.
        params = InteractingParams(
            start._replace(mean=10 * mean),
            jax.nn.softmax(chances),
            jax.nn.softmax(switching, axis=1),
            3 * sigmas[3],
        )
        at = jnp.where(there, 10 * position, jnp.nan)
        bare = scans._replace(position_m=at, covariance_m2=None)
        motions = [straight(sigmas[0], sigmas[2]), straight(sigmas[1], sigmas[2])]
        estimator = interacting(params, motions)
        info = jax.lax.scan(estimator.step, estimator.init(jax.random.key(0)), bare)[1]
        return info.log_likelihood.sum() / 10 + info.probability[-1, 1]

    arguments = (
        start.mean / 10,
        np.log(PROBABILITY[:2]),
        np.log(SWITCHING[:2, :2]),
        np.array([0.1, 2.0, 0.15, 1.1]),
        np.nan_to_num(scans.position_m) / 10,
    )
    gradients = assert_gradients_agree(loss, *arguments, step=3e-6, atol=1e-7)
    assert all(np.abs(g).max() > 1e-3 for g in gradients)
    np.testing.assert_array_equal(gradients[4][~there[:, 0, 0]], 0.0)


def test_filterpy_agrees():
    peer = pytest.importorskip("filterpy.kalman")
    # A turn of known rate is linear; FilterPy's models have matrices that do not change.
    rate, sigmas = 0.1, (0.1, 2.0, 0.5)
    dt = 1.0
    corner = np.stack([textbook.turned(np.append(e, rate), dt)[:4] for e in np.eye(4)], axis=1)
    matrices = [textbook.transition(dt), textbook.transition(dt), corner]
    noises = [textbook.acceleration_noise(dt, sigma) for sigma in sigmas]
    scans, looks = position_looks(5, own=False)
    time_s = 0.5 + np.arange(1.0, SIZE + 1)

    @jax.jit
    def run(params, scans, matrices, noises):
        motions = [
            Motion(lambda x, dt, f=f: f @ x, lambda dt, q=q: q)
            for f, q in zip(matrices, noises, strict=True)
        ]
        estimator = interacting(params, motions)
        return jax.lax.scan(estimator.step, estimator.init(jax.random.key(0)), scans)[1]

    info = run(PARAMS._replace(prior=prior()), scans._replace(time_s=time_s), matrices, noises)
    filters = []
    for f, q in zip(matrices, noises, strict=True):
        one = peer.KalmanFilter(dim_x=4, dim_z=2)
        one.x, one.P, one.F, one.Q = prior().mean, prior().covariance, f, q
        one.H, one.R = np.eye(2, 4), 9.0 * np.eye(2)
        filters.append(one)
    other = peer.IMMEstimator(filters, PROBABILITY, SWITCHING)
    pairs, chances, before = [], [], []
    for look in looks:
        other.predict()
        other.update(look["z"])
        pairs.append((other.x.copy(), other.P.copy()))
        chances.append(other.mu.copy())
        before.append([one.x.copy() for one in filters])
    assert_moments(info.filtered, pairs)
    np.testing.assert_allclose(info.probability, np.stack(chances), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(info.models.mean, np.stack(before), rtol=1e-9, atol=1e-9)


def manoeuvre(size):
    """Return times and states: 200 s straight, 40 s of turn at 0.15 rad/s, over and over."""
    state, states = np.array([0.0, 0.0, 10.0, 0.0, 0.0]), []
    for k in range(size):
        state = np.append(state[:4], 0.15 * (-1) ** (k // 240) if k % 240 >= 200 else 0.0)
        state = textbook.turned(state, 1.0)
        states.append(state)
    return np.arange(1.0, size + 1), np.stack(states)


def test_ten_thousand_steps_in_float32():
    rng = np.random.default_rng(8)
    time_s, states = manoeuvre(LONG)
    at = states[:, :2] + rng.normal(scale=3.0, size=(LONG, 2))
    seen = rng.random(LONG) < 0.9
    bare = position_looks(0, own=False, size=LONG)[0]
    scans = bare._replace(time_s=time_s, position_m=at[:, None], mask=seen[:, None])
    start = Prior(np.zeros(5), np.diag([1e4, 1e4, 1e2, 1e2, 1e-2]))  # pyright: ignore
    sigmas = np.array([0.02, 0.5, 0.02, 0.15, 0.005])
    state, info = jax.jit(filtered)(*single((PARAMS._replace(prior=start), scans, sigmas)))
    assert {x.dtype for x in jax.tree.leaves((state, info))} == {np.dtype(t) for t in ("f4", "?")}
    assert_sound(info.filtered.covariance)
    assert_sound(info.models.covariance.reshape(-1, 5, 5))
    np.testing.assert_allclose(info.probability.sum(1), 1.0, atol=1e-5)
    error = np.sqrt(((np.asarray(info.filtered.mean) - states)[10:, :2] ** 2).sum(1))
    assert error.max() < 30.0
    turning = np.abs(states[:, 4]) > 0
    late = np.roll(turning, 8) & turning  # eight looks after a turn has begun it is known
    calm = ~turning & ~np.roll(turning, 40)
    chance = np.asarray(info.probability)
    assert np.median(chance[late, 2]) > 0.6
    assert np.median(chance[calm, 0]) > 0.6


def test_one_model_is_its_filter_and_certain_models_do_not_mix():
    means, covariances = np.array([[1.0, 2.0], [3.0, 4.0]]), np.stack([np.eye(2), 2 * np.eye(2)])
    for chosen in (0, 1):
        sure = np.eye(2)[chosen]
        both = combine(means, covariances, sure)  # pyright: ignore
        np.testing.assert_array_equal(both.mean, means[chosen])
        np.testing.assert_array_equal(both.covariance, covariances[chosen])
    mixed, chance = mix(means, covariances, np.array([0.3, 0.7]), np.eye(2))  # pyright: ignore
    np.testing.assert_allclose(mixed.mean, means, rtol=1e-12)
    np.testing.assert_allclose(mixed.covariance, covariances, rtol=1e-12)
    np.testing.assert_allclose(chance, [0.3, 0.7])


def test_impossible_models_and_far_likelihoods_stay_finite():
    chance, total = jax.jit(reweigh)(jnp.array([0.0, 1.0]), jnp.array([0.0, -1e4]))
    assert np.isfinite(chance).all()
    assert np.isfinite(total)
    np.testing.assert_allclose(chance.sum(), 1.0)
    leave = np.array([[0.0, 1.0], [0.0, 1.0]])
    mixed, predicted = jax.jit(mix)(
        np.ones((2, 3)), np.ones((2, 3, 3)), np.array([1.0, 0.0]), leave
    )  # pyright: ignore
    assert np.isfinite(mixed.mean).all()
    np.testing.assert_array_equal(predicted, [0.0, 1.0])


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"params.probability: got shape \[3\], want \[1\]"):
        interacting(PARAMS, [straight(1.0, 1.0)])
    with pytest.raises(ValueError, match="motions"):
        interacting(PARAMS, [])
