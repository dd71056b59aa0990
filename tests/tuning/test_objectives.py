"""Losses of one realization: oracles, slopes, and what they are least at."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.filtering import kalman
from jaxtrack.hough import gate_for_false_rate
from jaxtrack.tuning import candidate_softmax, false_track_loss, negative_log_likelihood
from jaxtrack.types import Scan
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import tuning as oracle

CANDIDATES, TARGETS = 12, 3


@functools.cache
def softmax():
    return jax.jit(lambda s, m, n, t: candidate_softmax(s, m, n, temperature=t))


def candidates(seed, dtype=np.float64):
    rng = np.random.default_rng(seed)
    mask = rng.random(CANDIDATES) < 0.8
    scores = np.where(mask, rng.uniform(0.0, 6.0, CANDIDATES), np.nan).astype(dtype)
    return scores, mask, rng.random((CANDIDATES, TARGETS)) < 0.2


def test_candidates_equal_the_oracle():
    for seed in range(20):
        scores, mask, near = candidates(seed)
        expected = oracle.candidate_softmax(scores[mask], near[mask], 0.7)
        np.testing.assert_allclose(softmax()(scores, mask, near, 0.7), expected, rtol=1e-12)


def test_candidates_know_neither_order_nor_padding():
    scores, mask, near = candidates(1)
    expected = softmax()(scores, mask, near, 1.0)
    order = np.random.default_rng(0).permutation(CANDIDATES)
    np.testing.assert_allclose(softmax()(scores[order], mask[order], near[order], 1.0), expected)
    longer = (
        np.append(scores, np.nan),
        np.append(mask, False),
        np.append(near, [[True] * 3], axis=0),
    )
    np.testing.assert_allclose(softmax()(*longer, 1.0), expected, rtol=1e-12)
    stacked = [np.stack(x) for x in zip(*(candidates(s) for s in range(4)), strict=True)]
    alone = [softmax()(*candidates(seed), 1.0) for seed in range(4)]
    together = jax.vmap(lambda *case: softmax()(*case, 1.0))(*stacked)
    np.testing.assert_allclose(together, alone, rtol=1e-12)


def test_candidates_tend_to_the_shortfall_of_the_best():
    scores = jnp.array([5.0, 2.0, 4.0, 1.0])
    near = jnp.array([[True, False], [False, True], [False, False], [False, False]])
    loss = softmax()(scores, jnp.ones(4, bool), near, 1e-3)
    np.testing.assert_allclose(1e-3 * loss, (0.0 + (4.0 - 2.0)) / 2, rtol=1e-9)


def test_jitted_gradients_of_candidates_equal_differences():
    scores, mask, near = candidates(2)
    hide = lambda s: jnp.where(mask, s, jnp.nan)
    loss = lambda s, t: candidate_softmax(hide(s), jnp.asarray(mask), near, temperature=t)
    gradients = assert_gradients_agree(loss, np.nan_to_num(scores), 0.8)
    assert np.abs(gradients[0]).max() > 1e-2
    assert not gradients[0][~mask].any()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_candidates_are_finite_and_of_one_precision(dtype):
    run = jax.jit(jax.value_and_grad(lambda s, m, n, t: softmax()(s, m, n, t), argnums=(0, 3)))
    every, none = np.ones(CANDIDATES, bool), np.zeros(CANDIDATES, bool)
    for mask in (every, none):
        for near in (np.ones, np.zeros):
            for size in (0.0, 1e6):
                scores = np.where(mask, size, np.nan).astype(dtype)
                scores[0] = 0.0 if mask.any() else np.nan
                case = scores, mask, near((CANDIDATES, TARGETS), bool), jnp.asarray(0.1, dtype)
                for leaf in jax.tree.leaves(run(*case)):
                    assert leaf.dtype == dtype
                    assert np.isfinite(leaf).all()
    small = run(*candidates(3, dtype), jnp.asarray(0.7, dtype))
    large = run(*candidates(3), 0.7)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-2, atol=1e-5), small, large)


def filtered(sigma_m, scans):
    prior = kalman.Prior(jnp.zeros(4), jnp.eye(4) * 100.0)
    tracker = kalman.kalman(kalman.KalmanParams(prior, 0.01, sigma_m))
    _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)
    return negative_log_likelihood(info.log_likelihood, info.seen)


def straight_looks(sigma_m):
    rng = np.random.default_rng(5)
    t = np.arange(50.0)
    at = np.stack([3.0 * t, -t], axis=-1) + rng.normal(scale=sigma_m, size=(50, 2))
    mask = rng.random((50, 1)) < 0.8
    return Scan(t, np.ones(50, bool), np.where(mask[..., None], at[:, None], np.nan), mask)


@pytest.mark.slow
def test_the_likelihood_of_a_filter_is_best_at_the_noise_that_there_was():
    scans = straight_looks(2.0)
    value, slope = jax.jit(jax.value_and_grad(filtered))(2.0, scans)
    assert np.isfinite(value)
    curve = {sigma: float(jax.jit(filtered)(sigma, scans)) for sigma in (1.0, 1.8, 2.2, 4.0)}
    assert value < min(curve[1.0], curve[4.0])
    assert curve[1.8] + curve[2.2] > 2 * value - 1e-6  # convex here
    assert abs(slope) < abs(curve[4.0] - curve[1.0])
    assert_gradients_agree(lambda sigma: filtered(sigma, scans), 1.7)


def test_the_likelihood_is_the_mean_over_the_looks_that_were_seen():
    values, seen = np.array([-1.0, np.nan, -4.0]), np.array([True, False, True])
    run = jax.jit(jax.value_and_grad(negative_log_likelihood))
    value, slope = run(values, seen)
    assert value == 2.5
    np.testing.assert_array_equal(slope, [-0.5, 0.0, -0.5])
    value, slope = run(values, np.zeros(3, bool))
    assert value == 0.0
    assert not slope.any()


def votes(seed, runs=400, dtype=np.float64):
    rng = np.random.default_rng(seed)
    mask = rng.random((runs, 6)) < 0.7
    return np.where(mask, rng.exponential(3.0, (runs, 6)), np.nan).astype(dtype), mask


def test_gates_equal_the_oracle():
    values, mask = votes(0, 5)
    for row, there in zip(values, mask, strict=True):
        got = jax.jit(functools.partial(false_track_loss, false_per_run=0.3))(2.0, row, there)
        np.testing.assert_allclose(got, oracle.false_track_loss(2.0, row[there], 0.3), rtol=1e-12)


def test_the_least_mean_loss_is_at_the_gate_of_the_wanted_rate():
    values, mask = votes(1)
    gate = float(gate_for_false_rate(jnp.asarray(values), jnp.asarray(mask), 0.05))
    one = functools.partial(false_track_loss, false_per_run=0.05)
    mean = jax.jit(lambda g: jax.vmap(lambda v, m: one(g, v, m))(values, mask).mean())
    # Between two votes the loss is straight: no gate has a smaller one.
    assert all(mean(gate) <= mean(gate + step) + 1e-12 for step in np.linspace(-5.0, 5.0, 41))
    assert ((values >= gate) & mask).sum() == 0.05 * len(values)


def test_soft_gates_tend_to_hard_ones_and_their_gradients_equal_differences():
    values, mask = votes(2, 1)

    def loss(gate, temperature):
        args = values[0], mask[0]
        return false_track_loss(gate, *args, false_per_run=0.4, temperature=temperature)

    assert_gradients_agree(loss, 2.0, 0.5)
    hard = false_track_loss(2.0, values[0], mask[0], false_per_run=0.4)
    np.testing.assert_allclose(loss(2.0, 1e-4), hard, atol=1e-3)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_gates_are_finite_and_of_one_precision_and_leave_votes_alone(dtype):
    values, mask = votes(3, 1, dtype)
    for temperature in (None, 0.5):
        one = functools.partial(false_track_loss, false_per_run=0.4, temperature=temperature)
        run = jax.jit(jax.value_and_grad(one, argnums=(0, 1)))
        for there in (mask[0], np.zeros(6, bool)):
            value, slopes = run(jnp.asarray(2.0, dtype), values[0], there)
            assert np.isfinite(value)
            assert np.isfinite(slopes[0])
            assert value.dtype == slopes[0].dtype == dtype
            assert not slopes[1].any()


def test_arguments_that_do_not_fit_are_named():
    scores, mask, near = candidates(0)
    with pytest.raises(ValueError, match=r"near: got shape \[2, 3\], want \[12, K\]"):
        candidate_softmax(jnp.zeros(12), jnp.asarray(mask), jnp.asarray(near[:2]))
    with pytest.raises(TypeError, match="mask: got dtype float64, want booleans"):
        candidate_softmax(jnp.asarray(scores), jnp.ones(12), jnp.asarray(near))
    with pytest.raises(ValueError, match=r"false_per_run: got 0\.0, want a number above 0"):
        false_track_loss(1.0, jnp.zeros(2), jnp.ones(2, bool), false_per_run=0.0)
    with pytest.raises(TypeError, match="seen: got dtype float64, want booleans"):
        negative_log_likelihood(jnp.zeros(2), jnp.ones(2))
