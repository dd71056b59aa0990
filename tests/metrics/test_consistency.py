"""Swap and loss, NEES, NIS and the posterior Cramér–Rao bound."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxtrack.filtering import kalman
from jaxtrack.metrics import (
    chi_squared_quantile,
    consistency,
    cramer_rao,
    measurement_information,
    nees,
    nis,
    swap_and_loss,
)
from jaxtrack.models import range_bearing, transition_matrix, white_noise_acceleration
from jaxtrack.types import Pose
from tests.oracles import consistency as oracle

LOOKS, SIZE = 6, 4
H = np.eye(2, 4)


def definite(rng, size=SIZE):
    root = rng.normal(size=(size, size))
    scale = np.array([30.0, 30.0, 1.0, 1.0])[:size]
    return scale[:, None] * (root @ root.T + 0.3 * np.eye(size)) * scale[None, :]


def motion(rng):
    """Return F and Q of uneven steps; Q is singular."""
    dt = rng.uniform(0.5, 2.0, LOOKS)
    f = np.stack([transition_matrix(t) for t in dt])
    return f, np.stack([white_noise_acceleration(t, 0.3) for t in dt])


def test_swap_and_loss_equal_loops():
    rng = np.random.default_rng(0)
    judge = jax.jit(jax.vmap(swap_and_loss))
    truths = np.zeros((400, 5, 2, 2)) + np.array([[0.0, 0.0], [4.0, 0.0]])
    estimates = np.where(rng.random((400, 1, 1, 1)) < 0.5, truths, truths[:, :, ::-1])
    estimates = estimates + rng.normal(scale=2.0, size=(400, 1, 2, 2))
    found = judge(estimates, truths)
    wanted = [oracle.swap_and_loss(x, y, 3.0, 3) for x, y in zip(estimates, truths, strict=True)]
    np.testing.assert_array_equal(np.stack([found.swap, found.loss], -1), wanted)
    assert 30 < found.swap.sum() < 300
    assert 30 < found.loss.sum() < 300
    # Both tracks on one target: a loss; a track that is gone as well; what is early does not count.
    one = np.repeat(truths[:1, :, :1], 2, axis=2)
    gone = truths[:1].copy()
    gone[:, -1, 1] = np.nan
    early = truths[:1].copy()
    early[:, :2] += 100.0
    for case, loss in ((one, True), (gone, True), (early, False)):
        there = np.isfinite(case).all(-1)
        verdict = judge(np.repeat(case, 400, 0), truths, np.repeat(there, 400, 0))
        assert not verdict.swap.any()
        assert bool(verdict.loss[0]) == loss
        assert np.isfinite(verdict.own_m).all()


def test_normalized_errors_equal_the_quadratic_form():
    rng = np.random.default_rng(1)
    error = jax.jit(nees)
    for _ in range(5):
        mean, truth, p = rng.normal(size=4), rng.normal(size=4), definite(rng)
        found = error(mean, p, truth)
        assert bool(found.definite)
        np.testing.assert_allclose(found.squared, oracle.normalized(truth - mean, p), rtol=1e-10)
    singular = error(mean, np.zeros((4, 4)), truth)
    assert not bool(singular.definite)
    assert np.isfinite(singular.squared)


def test_quantiles_equal_scipys():
    freedom = np.array([1.0, 2.0, 4.0, 40.0, 2000.0, 50000.0])
    quantile = jax.jit(chi_squared_quantile)
    for probability in (1e-3, 0.025, 0.5, 0.975, 0.999):
        np.testing.assert_allclose(
            quantile(probability, freedom), stats.chi2.ppf(probability, freedom), rtol=1e-7
        )


def test_a_consistent_average_lies_inside_as_often_as_it_says():
    rng = np.random.default_rng(2)
    squared = rng.chisquare(4, size=(40, 2000))
    mask = rng.random(squared.shape) < 0.7
    run = jax.jit(lambda x, m: consistency(x, m, freedom=4))
    test = run(np.where(mask, squared, np.nan), mask)
    assert 0.93 < test.inside.mean() < 0.97
    n = int(test.runs[0])
    np.testing.assert_allclose(test.mean[0], squared[mask[:, 0], 0].mean(), rtol=1e-12)
    ends = stats.chi2.ppf([0.025, 0.975], 4 * n) / n
    np.testing.assert_allclose([test.lower[0], test.upper[0]], ends, rtol=1e-9)
    assert run(1.3 * squared, mask).inside.mean() < 0.6
    nobody = run(np.nan * squared, np.zeros_like(mask))
    assert not nobody.inside.any()
    assert np.isinf(nobody.upper).all()


def test_the_bound_of_a_linear_filter_is_the_kalman_filters_covariance():
    rng = np.random.default_rng(3)
    (f, q), p, r = motion(rng), definite(rng), definite(rng, 2)
    states, there = np.zeros((1, 4)), np.ones(1, bool)
    g = measurement_information(states, there, lambda x: x[:2], r)
    found = jax.jit(cramer_rao)(p, f, q, np.repeat(np.asarray(g)[None], LOOKS, 0))
    assert found.definite.all()
    update = jax.jit(lambda p, f, q: kalman.update(*kalman.predict(jnp.zeros(4), p, f, q), jnp.zeros(2), jnp.asarray(H), jnp.asarray(r)))  # fmt: skip # noqa: E501
    for k in range(LOOKS):
        p = update(p, f[k], q[k]).covariance
        np.testing.assert_allclose(found.covariance[k], p, rtol=1e-9, atol=1e-9)


def test_the_bound_equals_tichavskys_recursion():
    rng = np.random.default_rng(4)
    f, p = motion(rng)[0], definite(rng)
    q, g = (np.stack([definite(rng) * s for _ in range(LOOKS)]) for s in (1e-2, 1e-6))
    wanted = oracle.bound(p, f, q, g)
    np.testing.assert_allclose(jax.jit(cramer_rao)(p, f, q, g).covariance, wanted, rtol=1e-8)


def test_with_missed_detections_the_bound_is_below_the_enumeration():
    rng = np.random.default_rng(5)
    (f, q), p, r = motion(rng), definite(rng), definite(rng, 2)
    g = H.T @ np.linalg.inv(r) @ H
    bound = jax.jit(cramer_rao)
    for p_detect in (0.0, 0.6, 1.0):
        reduced = bound(p, f, q, np.repeat(p_detect * g[None], LOOKS, 0)).covariance
        mean = oracle.enumeration_bound(p, f, q, H, r, p_detect)
        scale = np.abs(mean).max()
        if p_detect == 0.6:
            least = np.linalg.eigvalsh(mean - reduced)
            assert (least > -1e-9 * scale).all()
            assert (np.trace(mean - reduced, axis1=1, axis2=2) > 0).all()
        else:
            np.testing.assert_allclose(reduced, mean, atol=1e-9 * scale)


def test_information_of_range_and_bearing_is_the_mean_over_the_states():
    rng = np.random.default_rng(6)
    states = rng.normal(size=(50, 4)) * [20.0, 20.0, 2.0, 2.0] + [80.0, 30.0, 0.0, 0.0]
    mask, p_detect = rng.random(50) < 0.8, rng.random(50)
    noise, position = np.diag([4.0, 1e-4]), np.array([5.0, -3.0])
    pose = Pose(jnp.asarray(position), jnp.asarray(0.7))
    run = jax.jit(
        lambda x, m, p: measurement_information(x, m, lambda s: range_bearing(s, pose), noise, p)
    )
    found = run(np.where(mask[:, None], states, np.nan), mask, p_detect)
    wanted = oracle.range_bearing_information(states, mask, position, noise, p_detect)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(run(np.nan * states, np.zeros(50, bool), p_detect), 0.0)


def test_errors_name_the_argument():
    x, p = jnp.zeros(4), jnp.eye(4)
    with pytest.raises(ValueError, match="truth: got shape"):
        nees(x, p, x[:2])
    with pytest.raises(ValueError, match="covariance: got shape"):
        nis(x, p[:2])
    with pytest.raises(ValueError, match="probability: got 1"):
        consistency(x, x == 0, freedom=2, probability=1.0)
    with pytest.raises(ValueError, match="noise: got shape"):
        cramer_rao(p, p[None], p, p[None])
    with pytest.raises(ValueError, match=r"p_detect: got \[2"):
        measurement_information(p, x == 0, lambda s: s, p, 2.0)
    with pytest.raises(ValueError, match="estimates_m: got 2 looks"):
        swap_and_loss(jnp.zeros((2, 2, 2)), jnp.zeros((2, 2, 2)))
