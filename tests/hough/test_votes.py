"""Vote kernels against loops, their limits, and the bound that queries are ranked by."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtrack.hough.votes import (
    Votes,
    accumulate,
    evaluate,
    gaussian,
    hard,
    interval_mass,
    scaled_gaussian,
    soft,
    upper_bound,
)
from tests.hough.cases import CELLS, GRID, RHO_MAX, SIZES, few
from tests.oracles import lines, votes

SIZE, QUERIES = 14, 16
EPS = (25.0, 0.07)
FLOAT = jnp.dtype(np.float64)
KERNELS = {
    "hard": lambda eps, scale, mask: hard(GRID, SIZES, FLOAT),
    "smoothed by 1": lambda eps, scale, mask: hard(GRID, SIZES._replace(smooth=1), FLOAT),
    "smoothed by 2": lambda eps, scale, mask: hard(GRID, SIZES._replace(smooth=2), FLOAT),
    "soft": lambda eps, scale, mask: soft(GRID, SIZES, *eps, FLOAT),
    "gaussian": lambda eps, scale, mask: gaussian(*eps),
    "scaled gaussian": lambda eps, scale, mask: scaled_gaussian(scale, mask),
}
# How much of a vote may count that the bound does not see: what is beyond three sigma.
UNSEEN = {"soft": 0.00135, "gaussian": math.exp(-4.5)}


def read(name, query, cast, scales):
    """The oracle's value of a kernel."""
    if name == "hard":
        return votes.hard_value(query, cast, CELLS)
    if name == "soft":
        return votes.soft_value(query, cast, CELLS, *EPS)
    if name == "gaussian":
        return votes.gaussian_value(query, cast, lines.tolerance_scale(*EPS))
    if name == "scaled gaussian":
        return votes.gaussian_value(query, cast, scales)
    return votes.smoothed_value(query, cast, CELLS, int(name[-1]))


@functools.cache
def jitted(name, function=evaluate):
    return jax.jit(
        lambda rho, theta, cast, eps, scale: function(
            rho, theta, cast, KERNELS[name](eps, scale, cast.mask)
        )
    )


@st.composite
def cases(draw):
    """Votes and queries beside them; many on the seam, some outside, NaN behind the mask."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rho = rng.uniform(-1.1 * RHO_MAX, 1.1 * RHO_MAX, SIZE)
    theta = np.where(rng.random(SIZE) < 0.5, rng.normal(scale=0.1, size=SIZE), 0.0)
    theta = np.where(theta == 0.0, rng.uniform(0.0, math.pi, SIZE), theta % math.pi)
    base = rng.integers(SIZE, size=QUERIES)
    cells_away = rng.normal(scale=2.0, size=(2, QUERIES)) * rng.integers(2, size=QUERIES)
    away = cells_away * np.array([[2 * RHO_MAX / SIZES.rho], [math.pi / SIZES.theta]])
    queries = [
        lines.wrap(rho[n] + d_rho, theta[n] + d_theta)
        for n, d_rho, d_theta in zip(base, *away, strict=True)
    ]
    mask = np.array(draw(st.lists(st.booleans(), min_size=SIZE, max_size=SIZE)))
    mask |= rng.random(SIZE) < 0.5
    factor = rng.normal(size=(SIZE, 2, 2)) + 2.0 * np.eye(2)
    scale = factor @ factor.transpose(0, 2, 1) * np.outer((20.0, 0.05), (20.0, 0.05))
    packed = np.stack([scale[:, 0, 0], scale[:, 0, 1], scale[:, 1, 1]], axis=-1)
    weight = rng.uniform(0.0, 1.0, SIZE)
    cast = [v for v, there in zip(zip(rho, theta, weight, strict=True), mask, strict=True) if there]
    hide = lambda x: np.where(mask, x, np.nan)
    packed = np.where(mask[:, None], packed, np.nan)
    table = Votes(*map(jnp.asarray, (hide(rho), hide(theta), hide(weight), mask)))
    return np.transpose(queries), table, packed, cast, scale[mask]


@pytest.mark.parametrize("name", KERNELS)
@few
@given(case=cases())
def test_kernel_equals_the_oracle(name, case):
    queries, table, packed, cast, scale = case
    got = jitted(name)(*queries, table, EPS, packed)
    expected = [read(name, query, cast, scale) for query in queries.T]
    np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-13)


@few
@given(cases())
def test_accumulator_equals_the_oracle(case):
    _, table, _, cast, _ = case
    got = jax.jit(lambda v: accumulate(v, GRID, sizes=SIZES))(table)
    np.testing.assert_allclose(got, votes.dense(cast, CELLS), rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("name", [name for name in KERNELS if name != "scaled gaussian"])
@few
@given(case=cases())
def test_bound_is_above_the_exact_value(name, case):
    queries, table, packed, cast, scale = case
    bound = jitted(name, upper_bound)(*queries, table, EPS, packed)
    unseen = UNSEEN.get(name, 0.0) * sum(vote[2] for vote in cast)
    for query, above in zip(queries.T, bound, strict=True):
        assert above + unseen >= read(name, query, cast, scale) - 1e-12


@pytest.mark.parametrize("name", ["hard", "smoothed by 1", "gaussian"])
def test_bound_holds_in_the_corners_of_the_space(name):
    edge = np.nextafter(np.pi, 0.0)
    at = [(r, t) for r in (-RHO_MAX, 0.0, -0.0, 21.0, 42.0, 419.9) for t in (0.0, 1e-16, edge)]
    rho, theta = np.transpose(at)
    for number in range(len(at)):
        one = np.arange(len(at)) == number
        table = Votes(*map(jnp.asarray, (rho, theta, np.ones(len(at)), one)))
        bound = jitted(name, upper_bound)(rho, theta, table, EPS, np.ones((len(at), 3)))
        exact = jitted(name)(rho, theta, table, EPS, np.ones((len(at), 3)))
        assert exact[number] > 0.01
        assert (bound + UNSEEN.get(name, 0.0) >= exact).all()


@few
@given(cases())
def test_soft_tends_to_hard(case):
    queries, table, packed, _, _ = case
    expected = jitted("hard")(*queries, table, EPS, packed)
    got = jitted("soft")(*queries, table, (1e-8, 1e-11), packed)
    np.testing.assert_allclose(got, expected, atol=1e-10)


def test_soft_votes_of_all_cells_sum_to_their_weights():
    # Far from the edges in ρ; the seam loses nothing.
    table = Votes(
        jnp.array([10.0, -33.0, 5.0]), jnp.array([0.01, 3.13, 1.0]), jnp.ones(3), jnp.ones(3, bool)
    )
    cells = [votes.centre_of(i, j, CELLS) for j in range(SIZES.theta) for i in range(SIZES.rho)]
    got = jitted("soft")(*np.transpose(cells), table, EPS, np.ones((3, 3)))
    np.testing.assert_allclose(got.sum(), 3.0, rtol=1e-9)


def test_interval_mass_keeps_its_precision_in_both_tails():
    distance = np.array([-400.0, -30.0, -1.0, 0.0, 1.0, 30.0, 400.0])
    got = jax.jit(interval_mass)(distance, 2.0, 3.0)
    expected = [votes.interval_mass(-1.0, 1.0, abs(d), 3.0) for d in distance]
    np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-300)
    assert got[1] > 0.0
