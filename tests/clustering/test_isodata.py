"""Fuzzy ISODATA: each operation and the whole against the loop, degenerate samples included."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.clustering import (
    IsodataParams,
    IsodataSizes,
    Partition,
    delete,
    divide,
    farthest_first,
    isodata,
    memberships,
    merge,
    partition,
)
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import csht, fuzzy

pytestmark = pytest.mark.slow  # compiles for minutes where nothing is cached

SHAPES = ((12, 6), (1, 3), (4, 7))  # N samples, K slots
SIZES = IsodataSizes(rounds=5, updates=2, iterations=3)
several = settings(max_examples=200, deadline=None, derandomize=True, database=None)

run_merge = jax.jit(merge)
run_partition = jax.jit(partition)
run_delete = jax.jit(delete)
run_divide = jax.jit(divide)
belong = jax.jit(memberships)
run = jax.jit(functools.partial(isodata, sizes=SIZES, tolerance=0.0))
start_from = jax.jit(farthest_first, static_argnames="clusters")


def names_of(p):
    """Return parameters by the names of the oracle."""
    return dict(zip(("m", "alpha_c", "gamma", "lambda_d", "theta", "a", "delta"), p, strict=True))


@st.composite
def problems(draw):
    """Return samples, weights, mask, centres, active, parameters; degenerate ones among them."""
    n, k = draw(st.sampled_from(SHAPES))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    places = rng.normal(scale=3.0, size=(3, 2))
    samples = places[rng.integers(0, 3, n)] + rng.normal(size=(n, 2)) * rng.uniform(0.1, 1.5)
    weights = rng.uniform(0.1, 4.0, n)
    kind = draw(st.sampled_from(("plain", "plain", "all alike", "no weight", "little weight")))
    if kind == "all alike":
        samples[:] = samples[0]
    elif kind == "no weight":
        weights[:] = 0.0
    elif kind == "little weight":
        weights *= 0.5 / weights.sum()
    mask = rng.random(n) < draw(st.sampled_from((0.0, 0.8, 1.0, 1.0)))
    active = rng.random(k) < draw(st.sampled_from((0.0, 0.6, 1.0)))
    p = IsodataParams(
        fuzzifier=rng.uniform(1.3, 2.2),
        merge_exponent=rng.uniform(0.1, 1.0),
        split_exponent=rng.uniform(-0.5, 1.5),
        split_step=rng.uniform(0.3, 1.0),
        membership_floor=rng.uniform(0.3, 0.7),
        aggregation_gate=rng.uniform(0.6, 0.95),
        delete_share=rng.uniform(0.0, 0.3),
    )
    return samples, weights, mask, rng.normal(scale=3.0, size=(k, 2)), active, p


def as_lists(samples, weights, mask, centres, active):
    held = [z if there else None for z, there in zip(centres, active, strict=True)]
    return list(samples[mask]), list(weights[mask]), held


def assert_same_slots(centres, active, expected, rtol=1e-9):
    np.testing.assert_array_equal(active, [z is not None for z in expected])
    for mine, z in zip(centres, expected, strict=True):
        if z is not None:
            np.testing.assert_allclose(mine, z, rtol=rtol, atol=1e-10)


@several
@given(problems())
def test_every_operation_equals_the_loop(problem):
    samples, weights, mask, centres, active, p = problem
    xs, ws, zs = as_lists(*problem[:5])
    names = names_of(p)
    weights = np.where(mask, weights, 0.0)
    mu = np.where(mask[None], belong(samples, centres, active=active, fuzzifier=p.fuzzifier), 0.0)

    mass = (weights * mu).sum(-1)
    merged = run_merge(centres, active, mass, merge_exponent=p.merge_exponent)
    expected = fuzzy.merge(xs, ws, zs, p.fuzzifier, p.merge_exponent)
    assert_same_slots(*merged, expected)

    found = run_partition(samples, weights, centres, active, mu, params=p)
    loop = fuzzy.statistics(xs, ws, zs, names["m"], names["gamma"], names["theta"])
    for mine, theirs in zip(found, loop, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-12)

    # The same statistics for both sides: these operations are decisions.
    same = Partition(*(np.asarray(x) for x in loop))
    left = run_delete(active, weights.sum(), same, params=p)
    expected = fuzzy.delete(zs, weights.sum(), *loop, names["a"], names["delta"])
    np.testing.assert_array_equal(left, [z is not None for z in expected])

    divided = run_divide(centres, active, same, params=p)
    expected = fuzzy.divide(zs, *loop[:3], names["a"], names["lambda_d"])
    assert_same_slots(*divided, expected)


@several
@given(problems())
def test_the_whole_equals_the_loop(problem):
    samples, weights, mask, centres, active, p = problem
    xs, ws, zs = as_lists(*problem[:5])
    hidden = np.where(mask[:, None], samples, np.nan), np.where(mask, weights, np.nan)
    free = np.where(active[:, None], centres, np.nan)
    got = run(*hidden, free, mask=mask, active=active, params=p)
    expected = fuzzy.isodata(
        xs, ws, zs, names_of(p), rounds=5, updates=2, iterations=SIZES.iterations
    )
    assert_same_slots(got.centres, got.active, expected, rtol=1e-6)
    assert not np.isnan(np.concatenate([np.ravel(x) for x in got])).any()
    assert not np.asarray(got.centres)[~np.asarray(got.active)].any()
    mu = fuzzy.memberships(xs, expected, p.fuzzifier)
    np.testing.assert_allclose(got.mass, (mu * ws).sum(-1), rtol=1e-5, atol=1e-8)


def test_the_operations_do_happen():
    """Of hundreds of problems many merge, delete, divide and come to rest: the tests can fail."""
    counts = np.zeros(4, int)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        samples = rng.normal(scale=3.0, size=(3, 2))[rng.integers(0, 3, 12)]
        samples = samples + rng.normal(size=(12, 2))
        centres, ones = rng.normal(scale=3.0, size=(6, 2)), np.ones(6, bool)
        active = np.arange(6) < 3 + seed % 3
        p = IsodataParams()
        mu = belong(samples, centres, active=active, fuzzifier=p.fuzzifier)
        mass = np.asarray(mu).sum(-1)
        left = run_merge(centres, ones, mass, merge_exponent=0.5)[1]
        counts[0] += not np.asarray(left).all()
        found = run_partition(samples, np.ones(12), centres, active, mu, params=p)
        left = run_delete(active, 12.0, found, params=p)
        counts[1] += not np.array_equal(left, active)
        more = run_divide(centres, active, found, params=p)[1]
        counts[2] += not np.array_equal(more, active)
        counts[3] += bool(run(samples, np.ones(12), centres, active=active, params=p).settled)
    assert (counts >= 10).all(), counts


@jax.jit
def gradient_of(samples, weights, mask, centres, active, p):
    def loss(samples, weights, centres, p):
        got = isodata(samples, weights, centres, mask=mask, active=active, params=p, sizes=SIZES)
        return (got.centres**2).sum() + got.mass.sum() + (got.membership**2).sum()

    return jax.grad(loss, (0, 1, 2, 3))(samples, weights, centres, p)


@several
@given(problems())
def test_gradients_are_finite_whatever_the_samples(problem):
    samples, weights, mask, centres, active, p = problem
    hidden = np.where(mask[:, None], samples, np.nan), np.where(mask, weights, np.nan)
    free = np.where(active[:, None], centres, np.nan)
    gradient = gradient_of(*hidden, mask, free, active, p)
    assert all(np.isfinite(g).all() for g in jax.tree.leaves(gradient))
    assert not gradient[0][~mask].any()
    assert not gradient[2].any()


def clouds(seed):
    """Return three clear groups of samples, weights and five starts."""
    rng = np.random.default_rng(seed)
    places = np.array([[0.0, 0.0], [8.0, 1.0], [2.0, 9.0]])
    samples = (places[:, None] + rng.normal(scale=0.5, size=(3, 5, 2))).reshape(-1, 2)
    return samples, rng.uniform(0.5, 3.0, 15), samples[[0, 1, 5, 6, 10]]


def test_it_finds_the_number_of_clear_groups_from_too_many_and_too_few():
    # A pattern between two groups counts as loose, and divides.
    loose = IsodataParams(aggregation_gate=0.95, split_exponent=3.0)
    find = jax.jit(isodata)
    for seed in range(10):
        samples, weights, start = clouds(seed)
        many = find(samples, weights, start)
        assert int(many.active.sum()) == 3
        assert bool(many.settled)
        begin = start[[0, 2, 4, 1, 3]] + np.array([[0.1, 0.0]])
        few = find(samples, weights, begin, active=np.arange(5) < 2, params=loose)
        assert int(few.active.sum()) == 3
        groups = np.asarray(few.membership)[np.asarray(few.active)].argmax(0).reshape(3, 5)
        assert (groups == groups[:, :1]).all()
        assert len(set(groups[:, 0])) == 3


def test_the_gradient_agrees_with_central_differences():
    samples, weights, start = clouds(1)
    sizes = IsodataSizes(iterations=300)

    def loss(samples, weights):
        got = isodata(samples, weights, start, tolerance=1e-14, sizes=sizes)
        return (got.centres * jnp.array([[1.0, -0.5]])).sum() + (got.mass**2).sum() / 50

    assert_gradients_agree(loss, samples, weights, atol=1e-8)


def test_starts_are_those_of_the_loop():
    for seed in range(40):
        rng = np.random.default_rng(seed)
        samples = rng.normal(size=(6, 2))
        weights, mask = rng.uniform(0.0, 2.0, 6), rng.random(6) < 0.7
        samples[1] = samples[0]
        got = start_from(np.where(mask[:, None], samples, np.nan), weights, mask=mask, clusters=5)
        expected = csht.farthest_first(list(samples[mask]), list(weights[mask]), 5)
        for index, z in zip(got, expected, strict=True):
            assert (index < 0) == (z is None)
            if z is not None:
                assert mask[index]
                np.testing.assert_array_equal(samples[index], z)


def test_permuting_and_padding_samples_changes_nothing():
    samples, weights, start = clouds(2)
    expected = run(samples, weights, start)
    order = np.random.default_rng(0).permutation(15)
    got = run(samples[order], weights[order], start)
    np.testing.assert_allclose(got.centres, expected.centres, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(got.membership, expected.membership[:, order], atol=1e-9)
    pad = lambda x: np.concatenate([x, np.full((3, *x.shape[1:]), np.nan)])
    got = run(pad(samples), pad(weights), start, mask=np.arange(18) < 15)
    np.testing.assert_allclose(got.centres, expected.centres, rtol=1e-9, atol=1e-12)


def test_single_precision_and_vmap():
    several = [clouds(seed) for seed in range(3)]
    stacked = [np.stack(x) for x in zip(*several, strict=True)]
    got = jax.jit(jax.vmap(functools.partial(isodata, sizes=SIZES)))(*stacked)
    for n, case in enumerate(several):
        alone = jax.jit(functools.partial(isodata, sizes=SIZES))(*case)
        np.testing.assert_allclose(got.centres[n], alone.centres, rtol=1e-9, atol=1e-12)
        single = run(*(x.astype(np.float32) for x in case))
        assert {x.dtype for x in single} == {np.dtype(np.float32), np.dtype(bool)}
        np.testing.assert_array_equal(single.active, alone.active)


def test_errors_name_the_argument():
    samples, weights, start = clouds(0)
    with pytest.raises(ValueError, match="weights: got shape"):
        isodata(samples, weights[:2], start)
    with pytest.raises(ValueError, match=r"sizes\.rounds: got 0"):
        isodata(samples, weights, start, sizes=IsodataSizes(rounds=0))
