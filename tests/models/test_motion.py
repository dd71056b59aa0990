"""Constant-velocity motion against the oracle's."""

import jax
import numpy as np

from jaxtrack.models.motion import propagate, transition_matrix
from tests.metrics.differences import assert_gradients_agree
from tests.oracles.joint import moved


def test_propagation_is_the_oracles_and_that_of_the_matrix():
    states = np.random.default_rng(0).normal(scale=100.0, size=(6, 4))
    for dt in (-1.5, 0.0, 2.0):
        got = jax.jit(propagate)(states, dt)
        expected = [moved(state, dt) for state in states]
        np.testing.assert_allclose(got, expected, rtol=1e-14)
        np.testing.assert_allclose(states @ jax.jit(transition_matrix)(dt).T, expected, atol=1e-10)


def test_each_state_may_have_its_own_time():
    states, times = np.random.default_rng(1).normal(size=(6, 4)), np.arange(6.0)
    expected = [moved(state, dt) for state, dt in zip(states, times, strict=True)]
    np.testing.assert_allclose(jax.jit(propagate)(states, times), expected, rtol=1e-14)


def test_two_steps_are_one_and_back_again_is_none():
    matrix = jax.jit(transition_matrix)
    np.testing.assert_allclose(matrix(0.7) @ matrix(1.6), matrix(2.3), rtol=1e-14)
    np.testing.assert_allclose(matrix(0.7) @ matrix(-0.7), np.eye(4), atol=1e-14)


def test_a_single_state_and_float32_keep_shape_and_dtype():
    state = np.array([1.0, 2.0, 3.0, 4.0], np.float32)
    got = jax.jit(propagate)(state, np.float32(0.5))
    assert got.dtype == jax.jit(transition_matrix)(np.float32(0.5)).dtype == np.float32
    np.testing.assert_array_equal(got, [2.5, 4.0, 3.0, 4.0])


def test_gradients_agree_with_central_differences():
    states = np.random.default_rng(2).normal(size=(3, 4))
    assert_gradients_agree(lambda x, dt: (propagate(x, dt) ** 2).sum(), states, np.arange(3.0))
