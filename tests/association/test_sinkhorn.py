"""Soft assignment by scaling: its optimum, its limits, its gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from jaxtrack.association import Associator, pda, sinkhorn, update_mixture
from jaxtrack.tracking import KalmanTrackerParams, kalman_tracker
from jaxtrack.types import Scan, Stage
from tests.association.test_marginals import problem
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import sinkhorn as oracle

soft = jax.jit(sinkhorn.marginals, static_argnames="iterations")


@pytest.mark.parametrize("temperature", [0.5, 1.0, 2.0])
def test_it_is_the_optimum_that_a_solver_finds(temperature):
    for seed in range(20):
        ratio, miss = problem(seed, (4, 5), decades=1.0)
        got = soft(ratio, miss, temperature=temperature, iterations=2000)
        np.testing.assert_allclose(got, oracle.shares(ratio, miss, temperature), atol=2e-6)
        np.testing.assert_allclose(got.sum(1), 1.0, rtol=1e-12)
        assert got[:, :-1].sum(0).max() < 1 + 1e-6
        assert not got[:, :-1][ratio == 0].any()


def test_towards_zero_it_is_the_optimal_assignment():
    for seed in range(20):
        ratio, miss = problem(seed, (4, 5), decades=1.0)
        cost = np.full((4, 9), np.inf)
        cost[:, :5] = -np.log(np.where(ratio > 0, ratio, np.nan))
        cost[np.arange(4), 5 + np.arange(4)] = -np.log(miss)
        row, column = linear_sum_assignment(np.where(np.isfinite(cost), cost, 1e6))
        best = np.zeros((4, 6))
        best[row, np.minimum(column, 5)] = 1.0
        got = soft(ratio, miss, temperature=0.01, iterations=3000)
        np.testing.assert_allclose(got, best, atol=0.02)


def test_alone_it_is_pda():
    ratio, miss = np.diag([4.0, 0.5, 9.0]), np.array([0.3, 1.0, 2.0])
    np.testing.assert_allclose(soft(ratio, miss), pda.marginals(ratio, miss), rtol=1e-12)


@pytest.mark.parametrize("iterations", [4, 200])
def test_gradients_are_central_differences_converged_or_not(iterations):
    ratio, miss = problem(3, (3, 4), zeros=0.0, decades=0.5)
    scale = jnp.asarray(np.random.default_rng(0).normal(size=(3, 5)))

    def loss(ratio, miss, temperature):
        shares = sinkhorn.marginals(ratio, miss, temperature=temperature, iterations=iterations)
        return (scale * shares**2).sum()

    assert_gradients_agree(loss, ratio, miss, jnp.asarray(0.8))
    several = np.stack([ratio, 2 * ratio])
    batch = jax.jit(jax.vmap(jax.grad(loss), in_axes=(0, None, None)))(several, miss, 0.8)
    np.testing.assert_allclose(batch[1], jax.jit(jax.grad(loss))(2 * ratio, miss, 0.8), rtol=1e-10)


def test_order_and_padding_change_nothing():
    ratio, miss = problem(5, (4, 5))
    got = soft(ratio, miss)
    order = np.array([2, 0, 3, 1])
    np.testing.assert_allclose(soft(ratio[order], miss[order]), got[order], rtol=1e-12, atol=1e-15)
    wide = soft(np.pad(ratio, ((0, 2), (0, 3))), np.pad(miss, (0, 2), constant_values=1.0))
    np.testing.assert_allclose(wide[:4, [0, 1, 2, 3, 4, 8]], got, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(wide[4:, 8], 1.0)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_extremes_are_finite(dtype):
    for ratio in (0.0, 1e-38, 1e38, jnp.inf):
        for miss in (0.0, 1.0):
            table = jnp.full((3, 2), ratio, dtype), jnp.full(3, miss, dtype)
            value, slope = jax.jit(
                jax.value_and_grad(
                    lambda w, m: (sinkhorn.marginals(w, m, temperature=0.1)[:, :-1] ** 2).sum(),
                    (0, 1),
                )
            )(*table)
            assert value.dtype == dtype
            assert np.isfinite(value)
            assert all(np.isfinite(x).all() for x in slope)
    assert soft(jnp.zeros((2, 0), dtype), jnp.ones(2, dtype)).shape == (2, 1)
    assert soft(jnp.zeros((0, 3), dtype), jnp.ones(0, dtype)).shape == (0, 4)


def test_a_tracker_follows_two_crossing_targets_with_it():
    time_s = jnp.arange(20.0)
    lines = (10 * time_s, 5 * time_s), (10 * time_s, 95 - 5 * time_s)
    at = jnp.stack([jnp.stack(line, -1) for line in lines], 1)
    noisy = at + jax.random.normal(jax.random.key(0), at.shape)
    scans = Scan(time_s, jnp.ones(20, bool), noisy, jnp.ones((20, 2), bool))
    tracker = kalman_tracker(
        KalmanTrackerParams(1.0, 0.05, 0.95, 1e-5, birth_sigma_m_s=8.0),
        max_tracks=4,
        associator=Associator(sinkhorn.associate, update_mixture),
    )
    _, info = jax.jit(lambda key: jax.lax.scan(tracker.step, tracker.init(key), scans))(
        jax.random.key(0)
    )
    tracks = jax.tree.map(lambda x: x[-1], info.tracks)
    shown = np.asarray(tracks.mask & (tracks.stage >= Stage.CONFIRMED))
    assert shown.sum() == 2
    gap = np.linalg.norm(np.asarray(tracks.mean)[shown][:, None, :2] - at[-1][None], axis=-1)
    assert gap.min(0).max() < 3.0


def test_errors_name_the_argument():
    with pytest.raises(ValueError, match="temperature: got 0"):
        sinkhorn.marginals(jnp.ones((2, 2)), jnp.ones(2), temperature=0.0)
    with pytest.raises(ValueError, match=r"miss: got shape \[3\], want \[2\]"):
        sinkhorn.marginals(jnp.ones((2, 2)), jnp.ones(3))
    with pytest.raises(ValueError, match="iterations: got 0"):
        sinkhorn.marginals(jnp.ones((2, 2)), jnp.ones(2), iterations=0)
