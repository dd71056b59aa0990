import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxtrack.numerics import assign, pair_up
from tests.oracles.assignment import least_cost_matching

JITTED = jax.jit(assign)


def check(cost, row_mask, column_mask):
    """Compare with brute force, and the parts of the result with each other."""
    found = JITTED(cost, row_mask, column_mask)
    columns, matched = np.asarray(found.columns), np.asarray(found.matched)
    with np.errstate(invalid="ignore"):
        allowed = row_mask[:, None] & column_mask[None, :] & np.isfinite(cost)
    pairs, total = least_cost_matching(np.where(allowed, cost, 0.0), allowed)
    assert matched.sum() == pairs
    np.testing.assert_array_equal(columns >= 0, matched)
    np.testing.assert_array_equal(columns[~matched], -1)
    assert len(set(columns[matched])) == pairs
    rows = np.flatnonzero(matched)
    assert allowed[rows, columns[rows]].all()
    rtol = 32 * np.finfo(found.cost.dtype).eps
    scale = np.max(np.abs(np.where(allowed, cost, 0.0)), initial=0.0)
    chosen = cost[rows, columns[rows]].astype(np.float64).sum()
    np.testing.assert_allclose(chosen, total, rtol=rtol, atol=rtol * scale)
    np.testing.assert_allclose(found.cost, total, rtol=rtol, atol=rtol * scale)
    return found


def masks_and_cost(shape, elements):
    rows, columns = shape
    return st.tuples(
        hnp.arrays(np.float64, shape, elements=elements),
        hnp.arrays(bool, rows),
        hnp.arrays(bool, columns),
    )


numbers = st.floats(-1e3, 1e3, allow_subnormal=False)
decades = st.tuples(st.floats(-8, 8), st.sampled_from([-1.0, 1.0])).map(lambda t: t[1] * 10 ** t[0])
with_forbidden = st.one_of(numbers, st.sampled_from([np.nan, np.inf, -np.inf]))


@pytest.mark.parametrize("elements", [numbers, decades, with_forbidden])
@pytest.mark.parametrize("shape", [(4, 4), (3, 5), (5, 3)])
def test_brute_force_finds_nothing_better(shape, elements):
    @settings(max_examples=60, deadline=None)
    @given(masks_and_cost(shape, elements))
    def run(problem):
        check(*problem)

    run()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("offset", [-1.0, 0.0, 1.0])
def test_padding_takes_no_digits_from_the_costs(scale, offset, dtype):
    rng = np.random.default_rng(5)
    for _ in range(10):
        cost = ((rng.random((4, 5)) + offset) * scale).astype(dtype)
        row_mask, column_mask = rng.random(4) < 0.7, rng.random(5) < 0.7
        check(cost, row_mask, column_mask)


def test_costs_near_the_largest_number_do_not_overflow():
    largest = np.finfo(np.float32).max
    cost = np.array([[largest, 1.0, 2.0], [largest, largest, 1.0]], dtype=np.float32)
    found = check(cost, np.array([True, True]), np.array([True, True, True]))
    assert found.columns.tolist() == [1, 2]
    check(-cost / 4, np.array([True, True]), np.array([True, False, True]))


@pytest.mark.parametrize("shape", [(4, 4), (3, 6), (6, 3)])
def test_scipy_agrees(shape):
    optimize = pytest.importorskip("scipy.optimize")
    rng = np.random.default_rng(6)
    for _ in range(30):
        cost = rng.normal(size=shape)
        row_mask, column_mask = rng.random(shape[0]) < 0.8, rng.random(shape[1]) < 0.8
        row, column = optimize.linear_sum_assignment(cost[np.ix_(row_mask, column_mask)])
        expected = np.full(shape[0], -1)
        expected[np.flatnonzero(row_mask)[row]] = np.flatnonzero(column_mask)[column]
        np.testing.assert_array_equal(JITTED(cost, row_mask, column_mask).columns, expected)


@pytest.mark.parametrize("cost", [np.zeros((3, 3)), np.full((3, 3), -2.5), np.full((3, 3), 1e-300)])
def test_equal_costs_still_match_as_many_as_possible(cost):
    found = check(cost, np.array([True, True, False]), np.array([False, True, True]))
    assert int(found.matched.sum()) == 2


@pytest.mark.parametrize(("rows", "columns"), [(0, 3), (3, 0), (0, 0)])
def test_empty_masks(rows, columns):
    row_mask, column_mask = np.arange(3) < rows, np.arange(3) < columns
    cost = jnp.full((3, 3), jnp.nan)
    found = JITTED(cost, row_mask, column_mask)
    assert found.columns.tolist() == [-1, -1, -1]
    assert not found.matched.any()
    assert found.cost == 0
    gradient = jax.jit(jax.grad(lambda c: assign(c, row_mask, column_mask).cost))(cost)
    np.testing.assert_array_equal(gradient, np.zeros((3, 3)))


def test_masked_entries_may_hold_anything():
    rng = np.random.default_rng(7)
    cost = rng.normal(size=(4, 5))
    row_mask = np.array([True, False, True, True])
    column_mask = np.array([True, True, False, True, False])
    total = jax.jit(jax.value_and_grad(lambda c: assign(c, row_mask, column_mask).cost))
    clean = total(cost)
    for rubbish in (np.nan, np.inf, -np.inf, 1e30, -1e30):
        dirty = np.where(row_mask[:, None] & column_mask[None, :], cost, rubbish)
        value, gradient = total(dirty)
        assert value == clean[0]
        np.testing.assert_array_equal(gradient, clean[1])


def test_forbidden_pairs_give_way_to_the_larger_matching():
    # Row 0 may take column 0 alone: row 1 must leave its cheap column 0 for the dear column 1.
    cost = np.array([[900.0, np.inf], [-900.0, 900.0]])
    found = check(cost, np.array([True, True]), np.array([True, True]))
    assert found.columns.tolist() == [0, 1]
    assert float(found.cost) == 1800.0


def test_gradient_is_one_at_the_matched_pairs():
    cost = jnp.array([[4.0, 1.0, 3.0], [2.0, 0.0, 5.0]])
    both, all_three = jnp.ones(2, dtype=bool), jnp.ones(3, dtype=bool)
    gradient = jax.jit(jax.grad(lambda c: assign(c, both, all_three).cost))(cost)
    np.testing.assert_array_equal(gradient, [[0, 1, 0], [1, 0, 0]])


def test_jitted_gradient_of_a_point_matching_agrees_with_central_differences():
    mask = np.array([True, True, False, True])

    def loss(points, others):
        square = jnp.sum((points[:, None, :] - others[None, :, :]) ** 2, axis=-1)
        return jnp.sqrt(assign(square, mask, jnp.ones(5, dtype=bool)).cost)

    jitted, gradient_of = jax.jit(loss), jax.jit(jax.grad(loss))
    rng = np.random.default_rng(8)
    for _ in range(10):
        points, others = rng.normal(size=(4, 2)), rng.normal(size=(5, 2))
        expected = np.zeros_like(points)
        for index in np.ndindex(points.shape):
            step = np.zeros_like(points)
            step[index] = 1e-6
            expected[index] = (jitted(points + step, others) - jitted(points - step, others)) / 2e-6
        np.testing.assert_allclose(gradient_of(points, others), expected, rtol=1e-6, atol=1e-9)


def test_a_batch_equals_its_members():
    rng = np.random.default_rng(9)
    cost, row_mask = rng.normal(size=(6, 4, 3)), rng.random((6, 4)) < 0.7
    column_mask = rng.random((6, 3)) < 0.7
    together = jax.jit(jax.vmap(assign))(cost, row_mask, column_mask)
    for trial in range(6):
        alone = JITTED(cost[trial], row_mask[trial], column_mask[trial])
        np.testing.assert_array_equal(together.columns[trial], alone.columns)
        assert together.cost[trial] == alone.cost


def test_dtypes_and_integer_costs():
    mask = jnp.ones(2, dtype=bool)
    assert assign(jnp.eye(2, dtype=jnp.float32), mask, mask).cost.dtype == jnp.float32
    found = assign(jnp.array([[3, 1], [1, 3]]), mask, mask)
    assert found.columns.dtype == jnp.int32
    assert float(found.cost) == 2.0


def test_errors_name_the_argument():
    mask = jnp.ones(2, dtype=bool)
    with pytest.raises(ValueError, match=r"cost: got shape \[2\], want \[M, N\]"):
        assign(jnp.zeros(2), mask, mask)
    with pytest.raises(ValueError, match=r"column_mask: got shape \[2\], want \[3\]"):
        assign(jnp.zeros((2, 3)), mask, mask)
    with pytest.raises(ValueError, match=r"row_mask: got shape \[2\], want \[3\]"):
        assign(jnp.zeros((3, 2)), mask, mask)


@pytest.mark.parametrize("shape", [(5, 4), (3, 5)])
def test_pairs_are_made_where_they_gain_and_no_others_gain_more(shape):
    rng = np.random.default_rng(10)
    jitted = jax.jit(pair_up)
    alone = 0
    for _ in range(60):
        gain = rng.normal(size=shape)
        gain[rng.random(shape) < 0.2] = rng.choice([np.nan, -np.inf, 0.0])
        gain[rng.random(shape) < 0.1] = 0.5  # ties
        columns = np.asarray(jitted(gain))
        rows = np.flatnonzero(columns >= 0)
        assert (gain[rows, columns[rows]] > 0).all()
        assert len(set(columns[rows])) == len(rows)
        # As many as possible of more columns, all of which may be taken for nothing.
        worth = np.where(gain > 0, gain, 0.0)
        spare = np.concatenate([-worth, np.zeros((shape[0], shape[0]))], axis=1)
        best = least_cost_matching(spare, np.ones_like(spare, bool))[1] if shape[0] < 4 else None
        if best is None:
            optimize = pytest.importorskip("scipy.optimize")
            row, column = optimize.linear_sum_assignment(spare)
            best = spare[row, column].sum()
        np.testing.assert_allclose(gain[rows, columns[rows]].sum(), -best, atol=1e-12)
        alone += len(rows) < min(shape)
    assert alone > 3


@pytest.mark.parametrize("shape", [(48, 32), (7, 60), (25, 25)])
def test_scipy_agrees_on_large_sparse_and_dense_problems(shape):
    optimize = pytest.importorskip("scipy.optimize")
    rng = np.random.default_rng(11)
    jitted = jax.jit(pair_up)
    for density in (0.03, 0.3, 1.0):
        for _ in range(8):
            gain = np.where(rng.random(shape) < density, rng.normal(size=shape) + 1.0, 0.0)
            spare = np.concatenate([-np.maximum(gain, 0.0), np.zeros((shape[0],) * 2)], axis=1)
            row, column = optimize.linear_sum_assignment(spare)
            expected = np.full(shape[0], -1)
            pairs = spare[row, column] < 0
            expected[row[pairs]] = column[pairs]
            np.testing.assert_array_equal(jitted(gain), expected)
    cost = rng.normal(size=shape)
    full = np.ones(shape[0], bool), np.ones(shape[1], bool)
    row, column = optimize.linear_sum_assignment(cost)
    found = JITTED(cost, *full)
    np.testing.assert_array_equal(np.asarray(found.columns)[row], column)
