"""The standard transform against loops and against scikit-image."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.hough import standard
from jaxtrack.hough.grid import Grid, Sizes
from jaxtrack.types import Scan
from tests.hough.cases import (
    GRID,
    ORIGIN,
    PEAKS,
    RHO_MAX,
    SIZES,
    assert_same_info,
    assert_same_lines,
    few,
    lines_of,
    looks,
    random_looks,
)
from tests.oracles import peaks, votes
from tests.oracles import standard as oracle

accumulator = jax.jit(lambda scan: standard.accumulator(scan, GRID, sizes=SIZES))
soft_votes = jax.jit(
    lambda rho, theta, scan, eps_rho, eps_theta: standard.soft_votes(
        rho, theta, scan, GRID, eps_rho, eps_theta, sizes=SIZES
    )
)


@few
@given(looks())
def test_accumulator_equals_the_oracle(scan):
    expected = oracle.accumulator(scan, ORIGIN, RHO_MAX, SIZES.rho, SIZES.theta)
    np.testing.assert_allclose(accumulator(scan), expected, rtol=1e-10, atol=1e-13)


@few
@given(looks(), st.integers(0, 2**32 - 1))
def test_soft_votes_equal_the_oracle(scan, seed):
    cells = np.random.default_rng(seed).integers((0, 0), (SIZES.rho, SIZES.theta), (8, 2))
    cells[0] = SIZES.rho, 5  # outside
    rho = (cells[:, 0] + 0.3) * 2 * RHO_MAX / SIZES.rho - RHO_MAX
    theta = (cells[:, 1] + 0.8) * np.pi / SIZES.theta
    got = soft_votes(rho, theta, scan, 12.0, 0.03)
    expected = [
        oracle.soft_cell(scan, ORIGIN, RHO_MAX, SIZES.rho, SIZES.theta, i, j, 12.0, 0.03)
        for i, j in cells[1:]
    ]
    assert got[0] == 0.0
    np.testing.assert_allclose(got[1:], expected, rtol=1e-10, atol=1e-13)


@few
@given(looks(shapes=((4, 5),)))
def test_soft_votes_tend_to_the_accumulator(scan):
    j, i = np.divmod(np.arange(SIZES.rho * SIZES.theta), SIZES.rho)
    rho = (i + 0.5) * 2 * RHO_MAX / SIZES.rho - RHO_MAX
    theta = (j + 0.5) * np.pi / SIZES.theta
    got = soft_votes(rho, theta, scan, 1e-9, 1e-12)
    np.testing.assert_allclose(got, accumulator(scan).ravel(), atol=1e-6)


def test_accumulator_equals_that_of_scikit_image():
    """Scikit-image rounds ρ to whole pixels between −D and D: 2 D + 1 cells of width one."""
    transform = pytest.importorskip("skimage.transform")
    rng = np.random.default_rng(0)
    image = np.zeros((40, 50), bool)
    image[rng.integers(40, size=30), rng.integers(50, size=30)] = True
    y, x = np.nonzero(image)
    cells = Sizes(rho=2 * math.ceil(math.hypot(40, 50)) + 1, theta=90)
    theta = (np.arange(90) + 0.5) * np.pi / 90
    expected, _, distance = transform.hough_line(image, theta=theta)
    assert distance[-1] == (cells.rho - 1) / 2
    position = np.stack([x, y], axis=-1)[None].astype(float)
    scan = Scan(jnp.zeros(1), jnp.ones(1, bool), jnp.asarray(position), jnp.ones((1, len(x)), bool))
    got = standard.accumulator(scan, Grid((0.0, 0.0), cells.rho / 2), sizes=cells)
    np.testing.assert_array_equal(got.T, expected)


@functools.cache
def estimate(sizes):
    return jax.jit(lambda scan, params: standard.estimate(scan, params, sizes=sizes))


def check_lines(sizes, scan, gate):
    extractor = PEAKS._replace(gate=gate)
    cells = votes.Grid(RHO_MAX, sizes.rho, sizes.theta)
    got, info = estimate(sizes)(scan, standard.StandardParams(GRID, extractor))
    table = oracle.accumulator(scan, ORIGIN, RHO_MAX, sizes.rho, sizes.theta)
    cast = [vote for vote in peaks.cell_votes(table, cells) if vote[2] > 0.0]
    separation = extractor.separation_rho_m, extractor.separation_theta_rad
    found = peaks.greedy_dense(table, cells, *separation, sizes.lines, sizes.smooth)
    refine = lambda peak: peaks.refine(peak, cast, cells, max(1, 3 * sizes.smooth))
    expected = lines_of(found, refine, extractor, ORIGIN)
    assert_same_lines(got, expected)
    assert_same_info(info, got, scan, extractor)
    assert info.votes is None


@few
@given(scan=looks(), gate=st.sampled_from((0.0, 2.0)))
def test_lines_equal_the_oracle(scan, gate):
    check_lines(SIZES, scan, gate)


@settings(max_examples=5, deadline=None, derandomize=True, database=None)
@given(scan=looks(shapes=((3, 3),)), gate=st.sampled_from((0.0, 0.2)))
def test_smoothed_lines_equal_the_oracle(scan, gate):
    check_lines(SIZES._replace(rho=20, theta=16, smooth=1), scan, gate)


def test_one_look_is_enough():
    scan = random_looks(np.random.default_rng(0), 2, 6)
    one = jax.tree.map(lambda x: jnp.asarray(x[:1]), scan)
    got, info = estimate(SIZES)(one, standard.StandardParams(GRID, PEAKS))
    assert got.votes[0] > 0.0
    assert info.members.shape == (SIZES.lines, 1, 6)
