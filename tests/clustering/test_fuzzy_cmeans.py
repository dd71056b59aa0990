"""Weighted fuzzy c-means: against the loop, against scikit-fuzzy, and its implicit gradient."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.clustering import fuzzy_cmeans, memberships, update
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import fuzzy

pytestmark = pytest.mark.slow  # compiles for minutes where nothing is cached

SHAPES = ((7, 3), (1, 2), (3, 5))  # N samples, K slots
several = settings(max_examples=120, deadline=None, derandomize=True, database=None)
cluster = jax.jit(fuzzy_cmeans, static_argnames="iterations")
once = jax.jit(update)
belong = jax.jit(memberships)


@st.composite
def problems(draw):
    """Samples, weights, mask, centres, active and m; coincidences and empty sets are among them."""
    n, k = draw(st.sampled_from(SHAPES))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    samples, centres = rng.normal(size=(n, 2)), rng.normal(size=(k, 2))
    weights = rng.uniform(0.0, 3.0, n)
    kind = draw(st.sampled_from(("plain", "centres on samples", "all alike", "no weight")))
    if kind == "centres on samples":
        centres[: min(n, k)] = samples[: min(n, k)]
        centres[-1] = samples[0]
    elif kind == "all alike":
        samples[:] = samples[0]
    elif kind == "no weight":
        weights[:] = 0.0
    mask = rng.random(n) < draw(st.sampled_from((0.0, 0.8, 1.0)))
    active = rng.random(k) < draw(st.sampled_from((0.0, 0.7, 1.0)))
    return samples, weights, mask, centres, active, rng.uniform(1.2, 3.0)


def as_lists(samples, weights, mask, centres, active):
    """Return what exists, the way the oracle has it."""
    held = [z if there else None for z, there in zip(centres, active, strict=True)]
    return list(samples[mask]), list(weights[mask]), held


@several
@given(problems())
def test_memberships_and_updates_equal_the_loop(problem):
    samples, weights, mask, centres, active, m = problem
    xs, ws, zs = as_lists(*problem[:5])
    got = belong(samples, centres, active=active, fuzzifier=m)
    np.testing.assert_allclose(got[:, mask], fuzzy.memberships(xs, zs, m), rtol=1e-10, atol=1e-14)
    whole = np.where(mask, weights, 0.0)
    moved = once(samples, whole, centres, active=active, fuzzifier=m)
    for z, mine, old in zip(fuzzy.update(xs, ws, zs, m), moved, centres, strict=True):
        np.testing.assert_allclose(mine, old if z is None else z, rtol=1e-9, atol=1e-12)


@several
@given(problems())
def test_the_whole_equals_the_loop_and_hides_what_is_masked(problem):
    samples, weights, mask, centres, active, m = problem
    xs, ws, zs = as_lists(*problem[:5])
    hidden = np.where(mask[:, None], samples, np.nan), np.where(mask, weights, np.nan)
    got = cluster(
        *hidden, centres, mask=mask, active=active, fuzzifier=m, tolerance=0.0, iterations=2
    )
    expected = fuzzy.cmeans(xs, ws, zs, m, 2)
    for z, mine, old in zip(expected, got.centres, centres, strict=True):
        np.testing.assert_allclose(mine, old if z is None else z, rtol=1e-8, atol=1e-10)
    there = fuzzy.objective(xs, ws, expected, m)
    np.testing.assert_allclose(got.objective, there, rtol=1e-7, atol=1e-12)
    assert not got.membership[:, ~mask].any()
    assert not got.membership[~active].any()


@several
@given(problems())
def test_gradients_are_finite_whatever_the_samples(problem):
    samples, weights, mask, centres, active, m = problem
    hidden = np.where(mask[:, None], samples, np.nan), np.where(mask, weights, np.nan)
    gradient = finite_gradient(*hidden, mask, centres, active, m)
    assert all(np.isfinite(g).all() for g in gradient)
    assert not gradient[0][~mask].any()
    assert not gradient[1][~mask].any()


@jax.jit
def finite_gradient(samples, weights, mask, centres, active, m):
    def loss(samples, weights, m, centres):
        got = fuzzy_cmeans(samples, weights, centres, mask=mask, active=active, fuzzifier=m)
        return (got.centres**2).sum() + got.objective + (got.membership**2).sum()

    return jax.grad(loss, (0, 1, 2, 3))(samples, weights, m, centres)


def blobs(seed, *, size=12):
    """Return samples about three places, weights, and starts beside the places."""
    rng = np.random.default_rng(seed)
    places = np.array([[0.0, 0.0], [5.0, 1.0], [1.0, 6.0]])
    samples = (places[:, None] + rng.normal(scale=0.6, size=(3, size // 3, 2))).reshape(-1, 2)
    return samples, rng.uniform(0.5, 3.0, size), places + 0.2


@pytest.mark.parametrize("m", [1.4, 2.0, 2.7])
def test_the_implicit_gradient_is_the_unrolled_one(m):
    samples, weights, start = blobs(1)
    active = np.array([True, True, False])
    scale = jnp.array([[1.0, -2.0]])

    def implicit(samples, weights, m):
        got = fuzzy_cmeans(
            samples, weights, start, active=active, fuzzifier=m, tolerance=1e-15, iterations=400
        )
        return (scale * got.centres**2).sum() + got.objective

    def unrolled(samples, weights, m):
        step = lambda z, _: (update(samples, weights, z, active=active, fuzzifier=m), None)
        z = jax.lax.scan(step, jnp.asarray(start), length=400)[0]
        mu = memberships(samples, z, active=active, fuzzifier=m)
        square = ((samples[None] - z[:, None]) ** 2).sum(-1)
        return (scale * z**2).sum() + (weights[None] * mu**m * square).sum()

    got = jax.jit(jax.grad(implicit, (0, 1, 2)))(samples, weights, m)
    expected = jax.jit(jax.grad(unrolled, (0, 1, 2)))(samples, weights, m)
    for mine, theirs in zip(got, expected, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-8, atol=1e-8)
        assert np.abs(theirs).max() > 1e-3


def test_the_gradient_agrees_with_central_differences():
    samples, weights, start = blobs(2, size=9)

    def loss(samples, weights, m):
        got = fuzzy_cmeans(samples, weights, start, fuzzifier=m, tolerance=1e-14, iterations=300)
        return (got.centres * jnp.array([[1.0, -0.5]])).sum() + (got.membership[0] ** 2).sum()

    assert_gradients_agree(loss, samples, weights, 1.9, atol=1e-8)


def test_where_the_iterations_started_has_no_gradient():
    samples, weights, start = blobs(3)
    loss = lambda z: fuzzy_cmeans(samples, weights, z).centres.sum()
    np.testing.assert_array_equal(jax.grad(loss)(jnp.asarray(start)), 0.0)


def test_weights_are_copies():
    samples, _, start = blobs(4)
    copies = np.random.default_rng(4).integers(1, 4, len(samples))
    got = cluster(samples, copies.astype(float), start)
    expected = cluster(np.repeat(samples, copies, axis=0), np.ones(copies.sum()), start)
    np.testing.assert_allclose(got.centres, expected.centres, rtol=1e-10)
    np.testing.assert_allclose(got.objective, expected.objective, rtol=1e-10)


@pytest.mark.parametrize("m", [1.5, 2.0])
def test_it_agrees_with_scikit_fuzzy(m):
    peer = pytest.importorskip("skfuzzy.cluster")
    for seed in range(20):
        samples, _, start = blobs(seed)
        begin = np.array(belong(samples, start, active=np.ones(3, bool), fuzzifier=m))
        centres, mu, *_, steps, _ = peer.cmeans(samples.T, 3, m, 1e-13, 1000, init=begin)
        assert steps < 1000
        got = cluster(
            samples, np.ones(len(samples)), start, fuzzifier=m, tolerance=1e-14, iterations=1000
        )
        np.testing.assert_allclose(got.centres, centres, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(got.membership, mu, rtol=1e-8, atol=1e-9)


def test_vmap_is_a_loop_and_single_precision_stays_single():
    samples, weights, start = (np.stack(x) for x in zip(*(blobs(s) for s in range(3)), strict=True))
    got = jax.jit(jax.vmap(functools.partial(fuzzy_cmeans, tolerance=1e-12)))(
        samples, weights, start
    )
    for n in range(3):
        alone = cluster(samples[n], weights[n], start[n], tolerance=1e-12)
        np.testing.assert_allclose(got.centres[n], alone.centres, rtol=1e-10)
        single = cluster(*(x[n].astype(np.float32) for x in (samples, weights, start)))
        assert all(x.dtype == np.float32 for x in single)
        np.testing.assert_allclose(single.centres, alone.centres, rtol=1e-4, atol=1e-4)


def test_errors_name_the_argument():
    samples, weights, start = blobs(0)
    with pytest.raises(ValueError, match=r"weights: got shape \[3\], want \[12\]"):
        fuzzy_cmeans(samples, weights[:3], start)
    with pytest.raises(ValueError, match=r"centres: got shape"):
        fuzzy_cmeans(samples, weights, start[:, :1])
    with pytest.raises(TypeError, match="iterations"):
        fuzzy_cmeans(samples, weights, start, iterations=2.5)  # pyright: ignore[reportArgumentType]
