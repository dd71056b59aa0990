"""Hard and soft choice: values, limits, gradients, and rows without an alternative."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.numerics.choice import choose, greater, step
from tests.metrics.differences import assert_gradients_agree

few = settings(max_examples=25, deadline=None, derandomize=True, database=None)
ROWS, COLUMNS = 6, 5


def picked(value, mask, table, index, temperature):
    pick, left = choose(value, mask, temperature)
    return pick(value), pick(table, index), left


hard = jax.jit(lambda *arguments: picked(*arguments, None))
soft = jax.jit(picked)


@st.composite
def tables(draw):
    """Values, some of them equal, with NaN behind the mask, and a table read by index."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    value = rng.integers(0, 4, (ROWS, COLUMNS)) * 1.0 if draw(st.booleans()) else None
    value = rng.uniform(0.0, 1.0, (ROWS, COLUMNS)) if value is None else value
    mask = rng.random((ROWS, COLUMNS)) < draw(st.sampled_from((0.0, 0.3, 0.8, 1.0)))
    return value, mask, rng.normal(size=(9, 2)), rng.integers(9, size=(ROWS, COLUMNS))


@few
@given(tables())
def test_hard_choice_is_the_first_of_the_largest(case):
    value, mask, table, index = case
    best, read, left = hard(np.where(mask, value, np.nan), mask, table, index)
    for row in range(ROWS):
        columns = np.flatnonzero(mask[row])
        if len(columns) == 0:
            assert best[row] == 0.0
            np.testing.assert_array_equal(read[row], 0.0)
            continue
        chosen = columns[np.argmax(value[row, columns])]
        assert best[row] == value[row, chosen]
        np.testing.assert_array_equal(read[row], table[index[row, chosen]])
        np.testing.assert_array_equal(left[row], np.arange(COLUMNS) != chosen)


@few
@given(tables())
def test_soft_choice_is_weighted_by_softmax(case):
    value, mask, table, index = case
    best, read, left = soft(np.where(mask, value, np.nan), mask, table, index, 0.4)
    weight = np.where(mask, np.exp(value / 0.4), 0.0)
    weight = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    np.testing.assert_allclose(best, (weight * value).sum(axis=1), rtol=1e-10)
    expected = (weight[..., None] * table[index]).sum(axis=1)
    np.testing.assert_allclose(read, expected, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(left, 1.0 - weight, atol=1e-12)


def test_soft_choice_tends_to_the_hard_one():
    rng = np.random.default_rng(0)
    case = rng.random((ROWS, COLUMNS)), rng.random((ROWS, COLUMNS)) < 0.7
    case += rng.normal(size=(9, 2)), rng.integers(9, size=(ROWS, COLUMNS))
    exists = case[1].any(axis=1)
    for got, expected in zip(soft(*case, 1e-6), hard(*case), strict=True):
        np.testing.assert_allclose(got[exists], expected[exists], atol=1e-9)


@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_soft_choice_does_not_overflow(shift):
    value = jnp.array([[1.0, 2.0]]) + shift
    best, *_ = soft(value, jnp.ones((1, 2), bool), jnp.zeros((1, 1)), jnp.zeros((1, 2), int), 1e-4)
    np.testing.assert_allclose(best, 2.0 + shift)


def test_step_and_greater():
    x = jnp.array([-3.0, 0.0, 2.0])
    assert step(x, None).tolist() == [0.0, 1.0, 1.0]
    np.testing.assert_allclose(step(x, 2.0), 1.0 / (1.0 + np.exp(-x / 2.0)), rtol=1e-12)
    np.testing.assert_allclose(step(x, 1e-9), [0.0, 0.5, 1.0])
    assert greater(x, -x, None).tolist() == [3.0, 0.0, 2.0]
    np.testing.assert_allclose(greater(x, -x, 1e-9), [3.0, 0.0, 2.0])


@pytest.mark.parametrize("temperature", [None, 0.3])
def test_gradients_agree_with_central_differences(temperature):
    rng = np.random.default_rng(1)
    mask = rng.random((ROWS, COLUMNS)) < 0.7
    mask[0] = False
    index = rng.integers(9, size=(ROWS, COLUMNS))
    hidden = jnp.where(mask, 0.0, jnp.nan)

    def loss(value, table, other):
        best, read, left = picked(value + hidden, mask, table, index, temperature)
        most = greater(best, other, temperature)
        return jnp.sin(most).sum() + jnp.sin(read).sum() + jnp.sin(left).sum()

    arguments = rng.random((ROWS, COLUMNS)), rng.normal(size=(9, 2)), rng.random(ROWS)
    assert_gradients_agree(loss, *arguments, atol=1e-8)
