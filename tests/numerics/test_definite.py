import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.numerics import definite_inverse, rounding_floor, scaled_cholesky, scaled_root


@pytest.mark.parametrize("seed", range(20))
def test_inverse_equals_numpy(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 6))
    matrix = root @ root.T
    inverse, definite = jax.jit(definite_inverse)(jnp.asarray(matrix))
    assert bool(definite)
    np.testing.assert_allclose(inverse, np.linalg.inv(matrix), rtol=1e-8)


def test_indefinite_and_singular_matrices_are_flagged_and_stay_finite():
    for matrix in (np.zeros((4, 4)), np.ones((4, 4)), np.diag([1.0, 1.0, -1.0, 1.0])):
        inverse, definite = jax.jit(definite_inverse)(jnp.asarray(matrix))
        assert not bool(definite)
        assert np.isfinite(inverse).all()
        assert (np.linalg.eigvalsh(inverse) > 0).all()


def test_scaled_cholesky_equals_numpy_whatever_the_units():
    rng = np.random.default_rng(0)
    run = jax.jit(functools.partial(scaled_cholesky, floor=rounding_floor(jnp.eye(1))))
    for n in (2, 5):
        root, units = rng.normal(size=(n, n + 2)), 10.0 ** rng.integers(-6, 6, n)
        matrix = units[:, None] * (root @ root.T) * units[None, :]
        lower, inverse, definite = run(matrix)
        assert bool(definite)
        scale = units[:, None]
        np.testing.assert_allclose(lower / scale, np.linalg.cholesky(matrix) / scale, rtol=1e-9)
        np.testing.assert_allclose(inverse @ lower, np.eye(n), atol=1e-9)


def test_the_floor_of_rounding_tells_singular_from_nearly_so():
    floor = rounding_floor(jnp.eye(1))
    nearly = np.array([[1.0, 1 - 1e-10], [1 - 1e-10, 1.0]])
    assert bool(scaled_root(nearly, floor=floor)[1])  # pyright: ignore
    assert not bool(scaled_root(nearly)[1])  # pyright: ignore
    assert not bool(scaled_root(np.ones((2, 2)), floor=floor)[1])  # pyright: ignore
