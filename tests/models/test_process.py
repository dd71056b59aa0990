"""Process noise and coordinated turns against the textbook's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.models import (
    constant_velocity,
    coordinated_turn,
    straight,
    turn,
    turn_noise,
    white_noise_acceleration,
)
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import kalman as oracle

jitted = jax.jit(turn)
slope = jax.jit(jax.jacfwd(turn))
STATE = np.array([3.0, -7.0, 5.0, 2.0, 0.0])


@pytest.mark.parametrize("rate", [0.0, 1e-9, 1e-4, 0.3, -0.3, 2.0, -5.0])
@pytest.mark.parametrize("dt", [1.0, -0.7, 0.0, 4.0])
def test_a_turn_is_the_textbooks(rate, dt):
    state = np.append(STATE[:4], rate)
    # The textbook divides by the rate, which costs digits near zero.
    known = abs(rate) > 1e-6 or rate == 0
    expected = oracle.turned(state if known else STATE, dt)[:4]
    tolerance = 1e-11 if known else 1e-7
    np.testing.assert_allclose(jitted(state, dt)[:4], expected, rtol=tolerance, atol=tolerance)
    assert float(jitted(state, dt)[4]) == rate


def test_two_turns_are_one_and_back_again_is_none():
    state = np.append(STATE[:4], 0.4)
    np.testing.assert_allclose(jitted(jitted(state, 0.6), 1.7), jitted(state, 2.3), rtol=1e-13)
    np.testing.assert_allclose(jitted(jitted(state, 2.0), -2.0), state, rtol=1e-13)


def test_without_a_turn_rate_value_and_slope_are_those_of_a_straight_line():
    dt = 1.5
    np.testing.assert_array_equal(jitted(STATE, dt)[:4], oracle.transition(dt) @ STATE[:4])
    matrix = np.asarray(slope(STATE, dt))
    np.testing.assert_allclose(matrix[:4, :4], oracle.transition(dt), atol=1e-15)
    vx, vy = STATE[2:4]
    expected = [-vy * dt**2 / 2, vx * dt**2 / 2, -vy * dt, vx * dt, 1.0]
    np.testing.assert_allclose(matrix[:, 4], expected, rtol=1e-14)


@pytest.mark.parametrize("rate", [0.0, 1e-3, 0.4, -1.3])
def test_slope_and_its_gradient_agree_with_central_differences(rate):
    state = np.append(STATE[:4], rate)
    if rate:
        expected = oracle.jacobian(lambda x: oracle.turned(x, 1.5), state)
        np.testing.assert_allclose(slope(state, 1.5), expected, rtol=1e-9, atol=1e-9)
    weights = np.random.default_rng(0).normal(size=(5, 5))

    def loss(state, dt):
        return (weights * jax.jacfwd(turn)(state, dt)).sum() + turn(state, dt).sum()

    assert_gradients_agree(loss, state, np.asarray(1.5), atol=1e-8)


def test_single_precision_keeps_the_slope_near_zero():
    for rate in (0.0, 1e-6, 1e-4, 1e-2):
        state = np.append(STATE[:4], rate)
        got = slope(state.astype(np.float32), np.float32(1.5))
        assert got.dtype == np.float32
        np.testing.assert_allclose(got, np.asarray(slope(state, 1.5)), rtol=1e-5, atol=1e-6)


def test_noise_is_that_of_accelerations_that_are_constant_in_a_step():
    for dt in (0.3, 2.0):
        got = jax.jit(white_noise_acceleration)(dt, 0.7)
        np.testing.assert_allclose(got, oracle.acceleration_noise(dt, 0.7), rtol=1e-14)
        got = jax.jit(turn_noise)(dt, 0.7, 0.1)
        np.testing.assert_allclose(got, oracle.turn_noise(dt, 0.7, 0.1), rtol=1e-14)


def test_motions_bundle_them():
    dt = jnp.asarray(1.5)
    state = jnp.asarray(np.append(STATE[:4], 0.4))
    motion = constant_velocity(0.7)
    np.testing.assert_allclose(motion.propagate(state[:4], dt), oracle.transition(1.5) @ state[:4])
    np.testing.assert_allclose(motion.noise(dt), oracle.acceleration_noise(1.5, 0.7))
    motion = coordinated_turn(0.7, 0.1)
    np.testing.assert_allclose(motion.propagate(state, dt), oracle.turned(np.array(state), 1.5))
    np.testing.assert_allclose(motion.noise(dt), oracle.turn_noise(1.5, 0.7, 0.1))
    motion = straight(0.7, 0.2)
    np.testing.assert_allclose(motion.propagate(state, dt)[:4], oracle.transition(1.5) @ state[:4])
    assert float(motion.propagate(state, dt)[4]) == 0
    noise = np.asarray(motion.noise(dt))
    np.testing.assert_allclose(noise[:4, :4], oracle.acceleration_noise(1.5, 0.7))
    np.testing.assert_allclose(noise[4], [0, 0, 0, 0, 0.04])
