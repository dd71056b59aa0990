"""The share by which a pattern survives: its loop, its limit, its slopes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.clustering import IsodataParams, delete, memberships, partition, survival
from tests.metrics.differences import assert_gradients_agree
from tests.oracles.soft_lifecycle import survival as oracle

PARAMS = IsodataParams(merge_exponent=0.3, aggregation_gate=0.75, delete_share=0.3)
run = jax.jit(survival)


def problem(seed, samples=14, patterns=4, active=3):
    """Return samples, weights, centres, active mask and memberships."""
    rng = np.random.default_rng(seed)
    places = rng.normal(scale=4.0, size=(active, 2))
    x = places[rng.integers(0, active, samples)] + rng.normal(size=(samples, 2))
    weights = rng.uniform(0.2, 3.0, samples)
    centres = np.full((patterns, 2), 0.0)
    centres[:active] = places + 0.3 * rng.normal(size=places.shape)
    there = np.arange(patterns) < active
    mu = memberships(x, jnp.asarray(centres), active=jnp.asarray(there), fuzzifier=1.6)
    return x, weights, centres, there, np.asarray(mu)


@pytest.mark.parametrize("width", [0.3, 0.05])
def test_it_equals_the_loop(width):
    names = {"alpha_c": 0.3, "gamma": 1.0, "theta": 0.5, "a": 0.75, "delta": 0.3}
    for seed in range(8):
        x, w, z, there, mu = problem(seed)
        got = run(x, w, z, there, mu, width, params=PARAMS)
        expected = oracle(x.tolist(), w.tolist(), z[there].tolist(), mu[there], width, names)
        np.testing.assert_allclose(got[:3], expected, rtol=1e-9, atol=1e-12)
        assert got[3] == 0.0


def test_it_tends_to_what_deletion_decides():
    # Patterns never near enough to merge: what is left is deletion alone.
    params = PARAMS._replace(merge_exponent=0.0)
    kept = 0
    for seed in range(30):
        x, w, z, there, mu = problem(seed)
        stays = delete(there, w.sum(), partition(x, w, z, there, mu, params=params), params=params)
        got = run(x, w, z, there, mu, 1e-6, params=params)
        np.testing.assert_allclose(got, stays, atol=1e-6)
        kept += int(stays.sum())
    assert 0 < kept < 90


def test_the_lighter_of_two_that_are_near_falls_to_the_other():
    x = np.array([[0.0, 0.0], [0.5, 0.0], [30.0, 0.0]])
    mu = np.eye(3)
    w = np.array([2.0, 1.5, 1.0])
    found = run(x, w, x, np.ones(3, bool), mu, 1e-3, params=PARAMS)
    np.testing.assert_allclose(found, [1.0, 0.0, 1.0], atol=1e-6)


def test_jitted_gradients_equal_differences():
    x, w, z, there, mu = problem(3)

    def loss(x, w, z, mu, alpha, theta, gate, share):
        params = PARAMS._replace(
            merge_exponent=alpha, membership_floor=theta, aggregation_gate=gate, delete_share=share
        )
        return (run(x, w, z, there, mu, 0.2, params=params) * jnp.arange(1.0, 5.0)).sum()

    gradients = assert_gradients_agree(loss, x, w, z, mu, 0.3, 0.5, 0.75, 0.3, rtol=1e-5)
    assert all(np.abs(g).max() > 1e-4 for g in gradients)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_values_and_slopes_are_finite_of_degenerate_samples(dtype):
    slopes = jax.jit(
        jax.value_and_grad(
            lambda *a: survival(*a[:3], a[5], *a[3:5], params=PARAMS).sum(), (0, 1, 2, 3)
        )
    )
    x, w, z, there, mu = problem(4)
    for samples, weights, active in (
        (x, w, there), (x * 0, w, there), (x, w * 0, there), (x, w, ~there), (x, w, there & False),
    ):  # fmt: skip
        case = (samples.astype(dtype), weights.astype(dtype), z.astype(dtype))
        for leaf in jax.tree.leaves(slopes(*case, mu.astype(dtype), dtype(0.05), active)):
            assert leaf.dtype == dtype
            assert np.isfinite(leaf).all()
