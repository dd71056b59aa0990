"""Lines through two points, their differences and covariances against loops."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.models.line import (
    line_covariance,
    line_difference,
    line_through,
    point_line_distance,
    wrap_line,
)
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import lines

few = settings(max_examples=25, deadline=None, derandomize=True, database=None)
through, covariance = jax.jit(line_through), jax.jit(line_covariance)
difference, wrap = jax.jit(line_difference), jax.jit(wrap_line)
SIZE = 20


@st.composite
def segments(draw):
    """Random segments, some of them along an axis, and an origin."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    first = rng.normal(scale=300.0, size=(SIZE, 2))
    second = first + rng.normal(scale=100.0, size=(SIZE, 2))
    axis = draw(st.integers(0, 1))
    second[:3, axis] = first[:3, axis]
    second[3, axis] = np.nextafter(first[3, axis], draw(st.sampled_from((-np.inf, np.inf))))
    return first, second, rng.normal(scale=200.0, size=2)


@few
@given(segments())
def test_line_through_equals_the_oracle(case):
    first, second, origin = case
    rho, theta = through(first, second, origin)
    expected = [lines.line_through(a, b, origin) for a, b in zip(first, second, strict=True)]
    np.testing.assert_allclose(rho, [e[0] for e in expected], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(theta, [e[1] for e in expected], rtol=1e-10, atol=1e-14)
    assert ((theta >= 0) & (theta < np.pi)).all()
    # Both points are on the line, in whichever order they come.
    for end in (first, second):
        distance = jax.vmap(point_line_distance)(rho, theta, end - origin)
        np.testing.assert_allclose(distance, 0.0, atol=1e-9)
    back = through(second, first, origin)
    for d in difference(rho, theta, *back):
        np.testing.assert_allclose(d, 0.0, atol=1e-9)


@few
@given(segments(), segments())
def test_differences_equal_the_oracle(p, q):
    p, q = (through(*case) for case in (p, q))
    got = difference(*p, *q)
    expected = [lines.difference(*map(float, line)) for line in zip(*p, *q, strict=True)]
    np.testing.assert_allclose(np.transpose(got), expected, rtol=1e-10, atol=1e-10)
    assert (np.abs(got[1]) <= np.pi / 2).all()


def test_difference_is_small_across_the_seam():
    rho, theta = jnp.array([5.0, -5.5]), jnp.array([0.01, 3.12])
    d_rho, d_theta = difference(rho, theta, rho[::-1], theta[::-1])
    np.testing.assert_allclose(d_rho, [-0.5, -0.5])
    np.testing.assert_allclose(d_theta, [math.pi - 3.11, 3.11 - math.pi])


@few
@given(st.integers(0, 2**32 - 1))
def test_wrap_equals_the_oracle(seed):
    rng = np.random.default_rng(seed)
    rho, theta = rng.normal(size=SIZE), rng.uniform(-math.pi, 2 * math.pi, SIZE)
    theta[:3] = 0.0, np.pi, -1e-20  # −1e-20 + π is π once more, the edge itself
    got = np.transpose(wrap(rho, theta))
    expected = [lines.wrap(*line) for line in zip(rho, theta, strict=True)]
    np.testing.assert_allclose(got[3:], expected[3:], rtol=1e-10, atol=1e-14)
    np.testing.assert_array_equal(got[:2], expected[:2])
    assert ((got[:, 1] >= 0) & (got[:, 1] < np.pi)).all()


@few
@given(segments())
def test_covariance_equals_the_oracle(case):
    first, second, origin = case
    got = covariance(first, second, origin, 7.0)
    expected = [
        lines.line_covariance(a, b, origin, 7.0) for a, b in zip(first, second, strict=True)
    ]
    picked = [[e[0, 0], e[0, 1], e[1, 1]] for e in expected]
    np.testing.assert_allclose(np.transpose(got), picked, rtol=1e-10, atol=1e-10)


def test_coincident_points_have_finite_values_and_gradients():
    points = jnp.array([[3.0, 4.0], [0.0, 0.0]])

    def total(first, second):
        values = (*line_through(first, second, jnp.zeros(2)),)
        values += line_covariance(first, second, jnp.zeros(2), jnp.asarray(2.0))
        return sum(v.sum() for v in values)

    assert [v.tolist() for v in through(points, points, jnp.zeros(2))] == [[0.0, 0.0]] * 2
    var = covariance(points, points, jnp.zeros(2), 2.0)
    assert [v.tolist() for v in var] == [[4.0, 4.0], [0.0, 0.0], [0.0, 0.0]]
    for gradient in jax.jit(jax.grad(total, argnums=(0, 1)))(points, points):
        assert np.isfinite(gradient).all()


@pytest.mark.parametrize("part", range(5))
def test_gradients_agree_with_central_differences(part):
    rng = np.random.default_rng(part)
    first, second = rng.normal(size=(2, 4, 2))

    def loss(first, second, origin):
        outputs = (*line_through(first, second, origin),)
        outputs += line_covariance(first, second, origin, jnp.asarray(0.3))
        return jnp.sin(outputs[part]).sum()

    assert_gradients_agree(loss, first, second, rng.normal(size=2), step=1e-6, atol=1e-8)
