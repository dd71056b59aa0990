"""Constant-velocity motion against the oracle's."""

import jax
import numpy as np

from jaxtrack.models.motion import propagate, transition_matrix
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
