"""The cloud model and C-means on it: against loops, and what its parts promise."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.clustering import cloud
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import cloud as oracle

K, N = 3, 8
several = settings(max_examples=25, deadline=None, derandomize=True, database=None)
backward = jax.jit(cloud.backward)
cmeans = jax.jit(cloud.cloud_cmeans, static_argnames="iterations")


def problem(seed, kind="plain"):
    """Return samples, weights, start, centres, floor, what is allowed, and draws."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(K, 2)) * 3
    samples = centres[rng.integers(K, size=N)] + rng.normal(size=(N, 2))
    if kind == "alike":
        samples[:] = samples[0]
    weights = rng.uniform(0.3, 2.0, N)
    start = -((samples[None] - centres[:, None]) ** 2).sum(-1)
    allowed = rng.random((K, N)) < {"plain": 0.8, "alike": 0.8, "none": 0.0, "all": 1.0}[kind]
    return samples, weights, start, centres, rng.uniform(0.2, 0.6, (N, 2)), allowed


problems = st.builds(problem, st.integers(0, 2**32 - 1), st.sampled_from(("plain", "none", "all")))


@several
@given(problems, st.booleans())
def test_cmeans_equal_the_loops(problem, drawn):
    samples, weights, start, centres, floor, allowed = problem
    xi = np.random.default_rng(0).normal(size=(K, 2)) if drawn else None
    got = cmeans(samples, weights, start, centres=centres, floor=floor, allowed=allowed, xi=xi)
    items = list(zip(samples, weights, floor, strict=True))
    classes, clouds, u, objective, done = oracle.cmeans(
        items, np.exp(start), allowed, [tuple(c) for c in centres], xi, 1e-6, 12
    )
    assert bool(got.done) == done
    for k, members in enumerate(classes):
        assert list(np.flatnonzero(got.members[k])) == members
        for mine, theirs in zip(got.cloud[:3], clouds[k], strict=True):
            np.testing.assert_allclose(mine[k], theirs, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(got.certainty, u, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(got.objective, objective, rtol=1e-7, atol=1e-9)


def test_the_backward_generator_is_the_loop_and_weights_are_copies():
    rng = np.random.default_rng(1)
    samples, copies = rng.normal(size=(N, 2)), rng.integers(0, 4, N)
    got = backward(samples, copies.astype(float))
    for axis in range(2):
        ex, en, he = oracle.backward(samples[:, axis], list(copies))
        np.testing.assert_allclose([x[axis] for x in got[:3]], [ex, en, he], rtol=1e-12)
    again = backward(np.repeat(samples, copies, axis=0), np.ones(copies.sum()))
    for a, b in zip(again, got, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)


def test_one_sample_has_no_width_and_none_are_nothing():
    samples = np.random.default_rng(2).normal(size=(N, 2))
    one = backward(samples, np.eye(N)[3])
    np.testing.assert_array_equal(one.expectation, samples[3])
    np.testing.assert_array_equal([one.entropy, one.hyper_entropy], 0.0)
    none = backward(samples, np.zeros(N))
    assert not any(x.any() for x in none)


def test_the_generators_are_inverse_to_each_other():
    made = cloud.Cloud(
        jnp.array([5.0, -2.0]), jnp.array([2.0, 0.5]), jnp.array([0.4, 0.1]), jnp.array(1.0)
    )
    drops, certainty = cloud.forward(jax.random.key(0), made, drops=200_000)
    back = backward(drops, jnp.ones(200_000))
    np.testing.assert_allclose(back.expectation, made.expectation, atol=0.02)
    np.testing.assert_allclose(back.entropy, made.entropy, rtol=0.02)
    # S² = En² + He² of an infinite sample: its root is what comes back.
    np.testing.assert_allclose(back.hyper_entropy, made.hyper_entropy, rtol=0.3)
    assert ((certainty > 0) & (certainty <= 1)).all()
    # −2 log u is the greater of two χ²₁: P(u > exp(−1/2)) = erf(1/√2)².
    np.testing.assert_allclose((certainty > np.exp(-0.5)).mean(), 0.6827**2, atol=0.005)


def test_the_mean_certainty_is_the_limit_of_many_draws():
    rng = np.random.default_rng(3)
    samples, floor = rng.normal(size=(N, 1)), np.full((N, 1), 1e-3)
    ex, en, he = np.zeros((1, 1)), np.full((1, 1), 1.5), np.full((1, 1), 0.2)
    got = np.exp(cloud.mean_log_certainty(*map(jnp.asarray, (samples, ex, en, he, floor))))
    width = np.abs(en[0] + he[0] * rng.normal(size=(200_000, 1)))
    expected = np.exp(-(samples.T**2) / (2 * width**2)).mean(0)
    np.testing.assert_allclose(got[0], expected, atol=1e-3)


def test_soft_classes_tend_to_the_crisp_ones_and_have_their_gradients():
    samples, weights, start, centres, floor, allowed = problem(4)
    settle = functools.partial(cmeans, centres=centres, floor=floor, allowed=allowed)
    crisp = settle(samples, weights, start)
    cold = settle(samples, weights, start, temperature=1e-7)
    np.testing.assert_allclose(cold.members, crisp.members, atol=1e-9)
    np.testing.assert_allclose(cold.cloud.expectation, crisp.cloud.expectation, rtol=1e-9)

    def loss(samples, weights, floor, temperature):
        got = cloud.cloud_cmeans(
            samples, weights, start, centres=centres, floor=floor, allowed=allowed,
            temperature=temperature, iterations=3,
        )  # fmt: skip
        return (got.cloud.expectation * jnp.array([[1.0, -0.5]])).sum() + got.objective

    assert_gradients_agree(loss, samples, weights, floor, 0.5, atol=1e-7)


@pytest.mark.parametrize("kind", ["plain", "alike", "none", "all"])
def test_gradients_are_finite_whatever_the_samples(kind):
    samples, weights, start, centres, floor, allowed = problem(5, kind)
    for heavy in (weights, 0 * weights):
        found = finite(samples, heavy, floor, start, centres, allowed)
        assert all(np.isfinite(x).all() for x in found)


@jax.jit
def finite(samples, weights, floor, start, centres, allowed):
    def loss(samples, weights, floor):
        got = cloud.cloud_cmeans(
            samples, weights, start, centres=centres, floor=floor, allowed=allowed, temperature=0.3
        )
        hyper = got.cloud.hyper_entropy.sum() + got.cloud.entropy.sum()
        return (got.cloud.expectation**2).sum() + got.objective + hyper

    return jax.grad(loss, (0, 1, 2))(samples, weights, floor)


def test_single_precision_stays_single():
    arguments = problem(6)
    small = [x.astype(np.float32) if x.dtype == np.float64 else x for x in arguments]
    got, expected = (
        cmeans(*x[:3], centres=x[3], floor=x[4], allowed=x[5]) for x in (small, arguments)
    )
    assert all(x.dtype == np.float32 for x in (*got.cloud, got.certainty, got.objective))
    np.testing.assert_allclose(got.cloud.expectation, expected.cloud.expectation, rtol=1e-4)


def test_errors_name_the_argument():
    samples, weights, start, centres, floor, _ = problem(0)
    with pytest.raises(ValueError, match=r"floor: got shape \[1, 2\], want \[8, 2\]"):
        cloud.cloud_cmeans(samples, weights, start, centres=centres, floor=floor[:1])
    with pytest.raises(ValueError, match="iterations: got 0"):
        cloud.cloud_cmeans(samples, weights, start, centres=centres, floor=floor, iterations=0)
    made = backward(samples, weights)
    with pytest.raises(TypeError, match="drops: got float"):
        cloud.forward(jax.random.key(0), made, drops=2.0)
