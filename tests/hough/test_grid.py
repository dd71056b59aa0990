"""Cells against the oracle's, and the seam."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.hough.grid import Grid, Sizes, cell_difference, cell_of, centre_of, check_sizes
from tests.hough.cases import CELLS, GRID, SIZES
from tests.oracles import votes


def test_cells_and_centres_equal_the_oracle():
    rng = np.random.default_rng(0)
    rho, theta = rng.uniform(-500.0, 500.0, 300), rng.uniform(0.0, np.pi, 300)
    i, j, inside = jax.jit(lambda *at: cell_of(*at, GRID, SIZES))(rho, theta)
    centre = jax.jit(lambda i, j: centre_of(i, j, GRID, SIZES, jnp.dtype(float)))(i, j)
    for n in range(300):
        cell = votes.cell_of(rho[n], theta[n], CELLS)
        assert inside[n] == (cell is not None)
        if cell is not None:
            assert (i[n], j[n]) == cell
            np.testing.assert_allclose([c[n] for c in centre], votes.centre_of(*cell, CELLS))


def test_cell_difference_takes_the_nearer_name():
    cells = [np.array(cell) for cell in ((3, 1), (3, 59), (36, 59), (36, 1))]
    for p in cells:
        for q in cells:
            d_i, d_j = cell_difference(*map(jnp.asarray, (*p, *q)), SIZES)
            twins = [q, (39 - q[0], q[1] - 60), (39 - q[0], q[1] + 60)]
            nearest = min(twins, key=lambda name: abs(name[1] - p[1]))
            assert (d_i, d_j) == (nearest[0] - p[0], nearest[1] - p[1])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_no_angle_below_a_half_turn_falls_out_of_the_grid(dtype):
    theta = np.array([0.0, np.nextafter(dtype(np.pi), dtype(0.0))], dtype)
    for n in (3, 9, 48, 180, 3142):
        _, j, inside = cell_of(jnp.zeros(2, dtype), jnp.asarray(theta), Grid(), Sizes(theta=n))
        assert inside.all()
        assert j.tolist() == [0, n - 1]


def test_sizes_are_checked():
    with pytest.raises(ValueError, match=r"sizes\.rho: got 0"):
        check_sizes(Sizes(rho=0))
    with pytest.raises(TypeError, match=r"sizes\.lines: got float"):
        check_sizes(Sizes(lines=2.0))  # pyright: ignore[reportArgumentType]
    check_sizes(Sizes(smooth=0))
