import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.numerics import definite_inverse


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
