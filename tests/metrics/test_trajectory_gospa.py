"""Trajectory GOSPA against brute force, its linear relaxation and the axioms."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.metrics import trajectory_gospa
from tests.oracles import trajectory_gospa as oracle

few = settings(max_examples=12, deadline=None, derandomize=True, database=None)
SHAPES = ((4, 2, 2), (3, 2, 3), (3, 3, 2), (2, 4, 4))  # T, I, K


@functools.cache
def jitted():
    return jax.jit(
        lambda x, xm, y, ym, c, p, g: trajectory_gospa(
            x, xm, y, ym, cutoff=c, order=p, switch_cost=g
        )
    )


def random_set(rng, looks, columns, spread=4.0, lattice=False):
    """Return [T, I, 2] points that jump, so that switching is worth its price now and then."""
    state = rng.normal(scale=spread, size=(looks, columns, 2))
    state = np.round(state / 3.0) * 3.0 if lattice else state
    mask = rng.random((looks, columns)) < 0.75
    return np.where(mask[..., None], state, np.nan), mask


@pytest.mark.parametrize("shape", SHAPES)
@few
@given(
    seed=st.integers(0, 2**32 - 1),
    numbers=st.sampled_from(((5.0, 1.0, 1.0), (5.0, 2.0, 2.0), (9.0, 1.5, 4.0), (3.0, 1.0, 6.0))),
    lattice=st.booleans(),
)
def test_distance_equals_brute_force_and_is_no_less_than_the_relaxation(
    shape, seed, numbers, lattice
):
    rng = np.random.default_rng(seed)
    looks, left, right = shape
    x, xm = random_set(rng, looks, left, lattice=lattice)
    y, ym = random_set(rng, looks, right, lattice=lattice)
    score = jitted()(x, xm, y, ym, *numbers)
    wanted = oracle.brute_force(x, xm, y, ym, *numbers)
    _, order, _ = numbers
    assert float(score.distance) == pytest.approx(wanted[0], rel=1e-11, abs=1e-12)
    assert sum(float(part) ** order for part in score[1:]) == pytest.approx(
        wanted[0] ** order, rel=1e-11, abs=1e-12
    )
    if not lattice:  # there the least cost can be had in several ways
        np.testing.assert_allclose(score, wanted, rtol=1e-10, atol=1e-11)
    relaxed = oracle.linear_programme(x, xm, y, ym, *numbers)
    assert float(score.distance) >= relaxed - 1e-7 * (1 + relaxed)


def test_the_relaxation_is_tight_in_most_cases():
    rng = np.random.default_rng(2)
    equal = 0
    for _ in range(40):
        x, xm = random_set(rng, 4, 2)
        y, ym = random_set(rng, 4, 2)
        ours = float(jitted()(x, xm, y, ym, 5.0, 1.0, 1.0).distance)
        equal += ours == pytest.approx(
            oracle.linear_programme(x, xm, y, ym, 5.0, 1.0, 1.0), rel=1e-7, abs=1e-7
        )
    assert equal >= 36


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_it_is_a_metric(order):
    rng = np.random.default_rng(7)
    trials = 300
    drawn = [[random_set(rng, 4, 2, 2.0, lattice=True) for _ in range(trials)] for _ in range(3)]
    (x, xm), (y, ym), (z, zm) = ([np.stack(part) for part in zip(*d, strict=True)] for d in drawn)
    score = jax.jit(jax.vmap(lambda *sets: jitted()(*sets, 5.0, order, 2.0)))
    there, back = score(x, xm, y, ym), score(y, ym, x, xm)
    np.testing.assert_allclose(there.distance, back.distance, rtol=1e-12, atol=1e-12)
    onward, direct = score(y, ym, z, zm).distance, score(x, xm, z, zm).distance
    assert np.all(direct <= there.distance + onward + 1e-10)
    np.testing.assert_array_equal(score(x, xm, x, xm).distance, 0.0)
    np.testing.assert_array_equal(score(x, xm, x[:, :, ::-1], xm[:, :, ::-1]).distance, 0.0)
    differs = (xm != ym).any((1, 2)) | (np.nan_to_num(x) != np.nan_to_num(y)).any((1, 2, 3))
    turned = (xm != ym[:, :, ::-1]).any((1, 2)) | (
        np.nan_to_num(x) != np.nan_to_num(y[:, :, ::-1])
    ).any((1, 2, 3))
    assert np.all(there.distance[differs & turned] > 0)


def test_order_of_columns_and_empty_ones_change_nothing():
    rng = np.random.default_rng(4)
    for _ in range(10):
        x, xm = random_set(rng, 3, 3)
        y, ym = random_set(rng, 3, 2)
        score = jitted()(x, xm, y, ym, 5.0, 1.0, 2.0)
        columns = rng.permutation(3)
        moved = jitted()(x[:, columns], xm[:, columns], y[:, ::-1], ym[:, ::-1], 5.0, 1.0, 2.0)
        np.testing.assert_allclose(moved, score, atol=1e-12)
        longer = np.concatenate([y, np.full((3, 2, 2), np.nan)], 1)
        more = np.concatenate([ym, np.zeros((3, 2), bool)], 1)
        padded = jitted()(x, xm, longer, more, 5.0, 1.0, 2.0)
        np.testing.assert_allclose(padded, score, atol=1e-12)


def test_what_happens_is_told_apart():
    truths = np.zeros((6, 1, 1)) + np.arange(6.0)[:, None, None]
    there = np.ones((6, 1), bool)
    score = lambda x, xm: np.array(jitted()(x, xm, truths, there, 10.0, 1.0, 2.0))
    late = there & (np.arange(6) >= 2)[:, None]
    np.testing.assert_allclose(score(truths, late), [10.0, 0.0, 10.0, 0.0, 0.0])
    np.testing.assert_allclose(score(truths + 1.0, there), [6.0, 6.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(score(truths + 50.0, there), [60.0, 0.0, 30.0, 30.0, 0.0])
    # The target is handed over to another identity: it goes from one to none to another.
    two = np.concatenate([truths, truths], 1)
    turns = np.stack([np.arange(6) < 3, np.arange(6) >= 3], 1)
    np.testing.assert_allclose(score(two, turns), [2.0, 0.0, 0.0, 0.0, 2.0])
    none = np.zeros((6, 0, 1)), np.zeros((6, 0), bool)
    np.testing.assert_allclose(score(*none), [30.0, 0.0, 30.0, 0.0, 0.0])


def test_memory_is_what_the_docstring_says():
    looks, left, right = 40, 3, 15
    single = lambda columns: jnp.zeros((looks, columns, 2), jnp.float32)
    there = lambda columns: jnp.ones((looks, columns), bool)
    sets = single(left), there(left), single(right), there(right)
    used = jitted().lower(*sets, 5.0, 1.0, 1.0).compile().memory_analysis().temp_size_in_bytes
    assert used < 1.1 * 4 * (looks + 3) * (right + 1) ** left


def test_errors_name_the_argument_and_the_limit():
    x, mask = jnp.zeros((3, 7, 2)), jnp.ones((3, 7), bool)
    numbers = {"cutoff": 1.0, "order": 1.0, "switch_cost": 1.0}
    with pytest.raises(ValueError, match=r"got 7 and 7 columns.*want at most 262144"):
        trajectory_gospa(x, mask, x, mask, **numbers)
    with pytest.raises(ValueError, match="truths: got shape"):
        trajectory_gospa(x, mask, x[:2], mask[:2], **numbers)
    with pytest.raises(ValueError, match="switch_cost: got 0"):
        trajectory_gospa(x, mask, x, mask, **(numbers | {"switch_cost": 0.0}))
    with pytest.raises(ValueError, match="no looks"):
        trajectory_gospa(x[:0], mask[:0], x[:0], mask[:0], **numbers)
