"""Range and bearing of a state against the oracle's."""

import jax
import numpy as np

from jaxtrack.models import range_bearing, range_bearing_residual
from jaxtrack.types import Pose
from tests.oracles import kalman as oracle


def test_range_and_bearing_and_their_slope_are_the_oracles():
    rng = np.random.default_rng(0)
    value_of, slope_of = jax.jit(range_bearing), jax.jit(jax.jacfwd(range_bearing))
    for _ in range(20):
        state, ship = rng.normal(scale=50.0, size=5), rng.normal(scale=50.0, size=2)
        heading = rng.uniform(-3.0, 3.0)
        pose = Pose(ship, np.asarray(heading))  # pyright: ignore
        value, matrix = value_of(state, pose), slope_of(state, pose)
        expected = oracle.range_bearing(state, ship, heading)
        np.testing.assert_allclose(value, expected, rtol=1e-12, atol=1e-12)
        expected = oracle.range_bearing_jacobian(state, ship)
        np.testing.assert_allclose(matrix, expected, rtol=1e-9, atol=1e-12)


def test_at_the_sensor_nothing_is_nan():
    pose = Pose(np.array([3.0, 4.0]), np.asarray(0.2))  # pyright: ignore
    matrix = jax.jacfwd(range_bearing)(np.array([3.0, 4.0, 1.0, 1.0]), pose)
    assert np.isfinite(matrix).all()


def test_the_residual_is_the_short_way_round():
    rng = np.random.default_rng(1)
    measured, expected = rng.uniform(-7.0, 7.0, (2, 30, 2))
    got = jax.jit(range_bearing_residual)(measured, expected)
    np.testing.assert_allclose(got[:, 0], measured[:, 0] - expected[:, 0])
    want = [oracle.wrapped(a - b) for a, b in zip(measured[:, 1], expected[:, 1], strict=True)]
    np.testing.assert_allclose(got[:, 1], want, atol=1e-14)
